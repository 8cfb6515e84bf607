"""The kinds of parameter files: which versions are read, what their quantities are, and which of them can be applied."""

from __future__ import annotations

from dataclasses import dataclass

from .document import Document

#: The axes of a sensor, and the pairs between which angles are.
AXES = ("x", "y", "z")
PAIRS = ("xy", "xz", "yz")


@dataclass(frozen=True)
class Quantity:
    """A quantity of a file: where it stands, its unit, where its standard uncertainty stands (empty: nowhere).

    `takes` picks the part of the uncertainty that belongs to it, and `diagonal` says that the uncertainties are those of a diagonal.
    """

    path: str
    unit: str
    std: str = ""
    takes: int | None = None
    diagonal: bool = False


@dataclass(frozen=True)
class Kind:
    """What is known of one kind of file."""

    version: int
    #: Quantities with a table of their own; None: every number of the file is one.
    quantities: tuple[Quantity, ...] | None = None
    #: Unit of every polynomial of a temperature, by the name of the polynomial.
    polynomials: tuple[tuple[str, str], ...] = ()
    #: Why files of an earlier version are refused; None: they are read.
    refused_before: str | None = None
    #: What the file lacks to be applied by itself; empty for files that are applied.
    lacks: str = ""


def _of(stem: str, unit: str, names: tuple[str, ...] = AXES) -> tuple[tuple[str, str], ...]:
    return tuple((f"{stem}_{name}", unit) for name in names)


_SIGMA = _of("sigma", "nT/enT")
_XI = _of("xi", "deg", PAIRS)
_B_OR = _of("b_or", "enT")
_B_OFF = _of("b_off", "enT")

_VALID = (Quantity("valid_degc", "degC"), Quantity("valid_field_nt", "nT"))
_LINEARISATION = (
    Quantity("linearisation.applied.c2_per_ent", "1/enT", "linearisation.applied.c2_std_per_ent"),
    Quantity("linearisation.applied.c3_per_ent2", "1/enT^2", "linearisation.applied.c3_std_per_ent2"),
    Quantity("linearisation.applied.reading_ent", "enT"),
)
#: How the sensor stands in its reference cube.
_REFERENCE = (Quantity("reference.rotation", "1"), Quantity("reference.std_deg", "deg"))

_NO_FIELD = "so that it takes no reading to a field; name a CPF, TPF, TCF or ground calibration file"

KINDS: dict[str, Kind] = {
    "CPF": Kind(
        1,
        (
            Quantity("run.temperature_degc", "degC"),
            Quantity("matrix.r_nom", "1"),
            Quantity("matrix.rho", "1"),
            Quantity("matrix.omega", "1"),
            Quantity("matrix.sigma", "nT/enT", "std.sigma", diagonal=True),
            Quantity("matrix.phi", "nT/enT", "std.phi"),
            Quantity("matrix.phi_tilde", "nT/enT", "std.phi_tilde"),
            *(Quantity(f"angle_deg.xi_{p}", "deg", "std.xi_deg", i) for i, p in enumerate(PAIRS)),
            *(
                Quantity(f"angle_deg.{name}", "deg", "std.lambda_mu_nu_deg", i)
                for i, name in enumerate(("lambda_x", "mu_y", "nu_z"))
            ),
            Quantity("offset.b_or_ent", "enT", "std.b_or_ent"),
            Quantity("valid.field_coil_nt", "nT"),
            Quantity("valid.temperature_degc", "degC"),
            *_LINEARISATION,
            *_REFERENCE,
        ),
    ),
    "OPF": Kind(
        1,
        (
            Quantity("run.temperature_degc", "degC"),
            Quantity("offset_ent", "enT", "offset_std_ent"),
            Quantity("residual_ent", "enT", "residual_std_ent"),
            Quantity("residual_coil_nt", "nT", "residual_coil_std_nt"),
        ),
        lacks="holds an offset without sigma and omega; name a TPF beside it",
    ),
    "FPF": Kind(
        1,
        (
            Quantity("run.temperature_degc", "degC"),
            Quantity("f_s_hz", "Hz", "f_s_std_hz"),
            Quantity("mean_f_s_hz", "Hz", "mean_f_s_std_hz"),
            Quantity("f_3db_igep_hz", "Hz"),
            Quantity("f_3db_model_hz", "Hz", "f_3db_model_std_hz"),
        ),
        lacks=f"holds a sampling frequency and a frequency response, no offset, sigma and omega, {_NO_FIELD}",
    ),
    "TPF": Kind(1, _VALID + _LINEARISATION + _REFERENCE, _SIGMA + _XI + _B_OR + _B_OFF),
    "TOF": Kind(
        1,
        (Quantity("valid_degc", "degC"),),
        _B_OFF,
        lacks="holds an offset without sigma and omega; name a TPF beside it",
    ),
    "TAF": Kind(
        1,
        (
            Quantity("valid_degc", "degC"),
            Quantity("mean_sample_rate_hz", "Hz", "mean_std_sample_rate_hz"),
        ),
        _of("f_3db", "Hz") + _of("f_3db_igep", "Hz"),
        lacks=f"holds -3 dB frequencies, no offset, sigma and omega, {_NO_FIELD}",
    ),
    "TCF": Kind(
        2,
        (
            *_VALID,
            *_LINEARISATION,
            *_REFERENCE,
            Quantity("reference_degc", "degC"),
            Quantity("sigma_remainder", "nT/enT"),
            Quantity("xi_remainder_deg", "deg"),
            Quantity("k", "1", "k_std"),
            Quantity("k_matrix", "1"),
            Quantity("k_inverse", "1", "k_inverse_std"),
            Quantity("residual_field.b_res_ent", "enT", "residual_field.b_res_std_ent"),
        ),
        _SIGMA + _XI + _B_OFF + _B_OR,
        refused_before="its angles are those between the sensor axes in the formula of the other convention, so that every "
        "misalignment has the wrong sign",
    ),
    "RPCMAG": Kind(
        2,
        tuple(
            Quantity(label, unit, f"std.{label}")
            for label, unit in (
                ("A_0", "enT"),
                ("A_1", "enT/degC"),
                ("B_RES", "enT"),
                ("SIGMA_00", "nT/enT"),
                ("SIGMA_01", "nT/enT/degC"),
                ("XI_10", "deg"),
                ("XI_11", "deg/degC"),
                ("K_0", "1"),
                ("K_1", "1"),
                ("K_2", "1"),
                ("T_0", "degC"),
                ("T_1", "degC/V"),
                ("T_2", "degC/V^2"),
                ("T_3", "degC/V^3"),
                ("T_OFF", "degC"),
            )
        )
        + _VALID
        + _REFERENCE,
    ),
    "LINEARISATION": Kind(
        1,
        (
            Quantity("linearisation.c2_per_ent", "1/enT", "linearisation.c2_std_per_ent"),
            Quantity("linearisation.c3_per_ent2", "1/enT^2", "linearisation.c3_std_per_ent2"),
            Quantity("linearisation.reading_ent", "enT"),
        ),
        lacks=f"linearises readings and holds no offset, sigma and omega, {_NO_FIELD} made with it",
    ),
    "THERMISTOR": Kind(
        1,
        (
            # Coefficients of the signal, whose unit stands under `signal_unit`.
            Quantity("coefficients", "degC", "coefficients_std"),
            Quantity("reference.offset_degc", "degC", "reference.offset_std_degc"),
            Quantity("valid_degc", "degC"),
        ),
        lacks=f"turns a signal into a temperature and holds no offset, sigma and omega, {_NO_FIELD}",
    ),
    "NULL": Kind(1, lacks=f"holds the drift and noise of an offset, no sigma and omega, {_NO_FIELD}"),
    "COIL_SCALAR": Kind(1, lacks=f"holds parameters of the coil system, not of a sensor, {_NO_FIELD}"),
    "COIL_RESIDUAL": Kind(1, lacks=f"holds the residual field of the coil system, not parameters of a sensor, {_NO_FIELD}"),
    "COIL_TILT": Kind(1, lacks=f"holds corrections of the coil system, not the calibration of a sensor, {_NO_FIELD}"),
    "MODEL": Kind(1, lacks=f"holds effects beside the linear sensor, no offset, sigma and omega, {_NO_FIELD}"),
}


def kind_of(document: Document) -> Kind:
    """The kind of a file whose version can be read."""
    kind = KINDS.get(document.format)
    if kind is None:
        known = ", ".join(KINDS)
        raise document.refuse("format", f"is `{document.format}`, which this package does not know", f"name one of {known}")
    version = document.version
    if version < 1 or version > kind.version:
        raise document.refuse("version", f"is {version}, not {kind.version}", "use a newer version of this package")
    if version < kind.version and kind.refused_before is not None:
        raise document.refuse("version", f"is {version}: {kind.refused_before}", "make it again from the files that it names")
    if document.format == "RPCMAG" and version == 1 and document.get("provenance.tool") == "calfit":
        # Other programs may have written version 1 with the angles that it states.
        raise document.refuse(
            "version",
            "is 1: in such files of calfit every misalignment has the wrong sign",
            "export it again from the files that it names",
        )
    return kind
