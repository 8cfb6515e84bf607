"""The one exception of this package."""


class Refused(ValueError):
    """A file or an input that is not taken: where, which rule it breaks, and what to do."""

    def __init__(self, file: str, key: str, rule: str, remedy: str) -> None:
        self.file = file
        self.key = key
        self.rule = rule
        self.remedy = remedy
        place = f"{file}: `{key}`" if key else file
        super().__init__(f"{place} {rule}; {remedy}")
