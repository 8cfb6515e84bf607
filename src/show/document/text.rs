//! Text inside a paragraph, an item of a list or a cell.

/// A piece of text of one kind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Inline {
    /// Words.
    Plain(String),
    /// A file name, a command, a symbol of a formula.
    Code(String),
    /// Words that stand out.
    Strong(String),
    /// Words that lead to another place.
    Link {
        /// The words.
        words: String,
        /// A place in the document such as `#2-runs`, a file beside it, or an address.
        to: String,
    },
}

/// Text of several kinds, in its order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Text(pub Vec<Inline>);

impl Text {
    /// Words and code in turn, words first: `["in ", "run", " or ", "mode"]` is in `run` or `mode`.
    #[must_use]
    pub fn words_and_code<S: Into<String>>(parts: impl IntoIterator<Item = S>) -> Self {
        let parts = parts.into_iter().map(Into::into).enumerate();
        let inline = parts.map(|(i, part)| if i % 2 == 0 { Inline::Plain(part) } else { Inline::Code(part) });
        Self(inline.collect())
    }

    /// The text of a note or finding, which sets names between backticks, on the terminal as in files.
    #[must_use]
    pub fn of_note(text: &str) -> Self {
        // A backtick without a second one stands for itself.
        if text.matches('`').count().is_multiple_of(2) { Self::words_and_code(text.split('`')) } else { text.into() }
    }

    /// The same with more words.
    #[must_use]
    pub fn and(mut self, words: impl Into<String>) -> Self {
        self.0.push(Inline::Plain(words.into()));
        self
    }

    /// The same with code after it.
    #[must_use]
    pub fn code(mut self, code: impl Into<String>) -> Self {
        self.0.push(Inline::Code(code.into()));
        self
    }

    /// The same with words after it that stand out.
    #[must_use]
    pub fn strong(mut self, words: impl Into<String>) -> Self {
        self.0.push(Inline::Strong(words.into()));
        self
    }

    /// The same with a link after it.
    #[must_use]
    pub fn link(mut self, words: impl Into<String>, to: impl Into<String>) -> Self {
        self.0.push(Inline::Link { words: words.into(), to: to.into() });
        self
    }

    /// The words alone.
    #[must_use]
    pub fn plain(&self) -> String {
        let words = |inline: &Inline| match inline {
            Inline::Plain(words) | Inline::Code(words) | Inline::Strong(words) | Inline::Link { words, .. } => words.clone(),
        };
        self.0.iter().map(words).collect()
    }
}

impl From<String> for Text {
    fn from(words: String) -> Self {
        if words.is_empty() { Self::default() } else { Self(vec![Inline::Plain(words)]) }
    }
}

impl From<&str> for Text {
    fn from(words: &str) -> Self {
        words.to_owned().into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_a_note_are_code_and_an_odd_backtick_is_itself() {
        let text = Text::of_note("correct `run` in one of the two");
        assert_eq!(text, Text::from("correct ").code("run").and(" in one of the two"));
        assert_eq!(Text::of_note("a ` b"), Text::from("a ` b"));
        assert_eq!(text.plain(), "correct run in one of the two");
    }
}
