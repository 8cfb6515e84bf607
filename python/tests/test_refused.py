"""What is not known, contradicts itself or does not belong together is refused with file, key, rule and remedy."""

import calfit
import make
import numpy as np
import pytest

RAW = (100.0, -2000.0, 3000.0)


def refused(call, file, key, rule):
    """The exception names all four parts, and its message holds them."""
    with pytest.raises(calfit.Refused) as caught:
        call()
    error = caught.value
    assert file in error.file, error
    assert key == error.key, error
    assert rule in error.rule, error
    assert error.remedy and error.remedy in str(error) and error.rule in str(error)


NAN = float("nan")
TWO = {"quantity": "b_or", "acts": "after the matrix", "sign": "subtracted", "unit": "enT"}

FILES = [
    # kind, key that is changed, value, key of the refusal, rule
    ("cpf", "format", "XYZ", "format", "`XYZ`, which this package does not know"),
    ("cpf", "format", None, "format", "is missing"),
    ("cpf", "version", 2, "version", "is 2, not 1"),
    ("cpf", "version", None, "version", "is missing"),
    ("tcf", "version", 1, "version", "wrong sign"),
    ("tcf", "version", 3, "version", "is 3, not 2"),
    ("cpf", "apply.steps", ["subtract_offset", "omega", "sigma", "rho", "r_nom"], "apply.steps", "`omega` is not known there"),
    ("cpf", "apply.steps", ["subtract_offset", "sigma", "omega", "filter"], "apply.steps", "`filter` is not known there"),
    ("tpf", "apply.steps", ["subtract_offset", "sigma", "omega", "rho", "r_nom"], "apply.steps", "not how TPF files"),
    ("tof", "apply.steps", ["linearise", "subtract_offset"], "apply.steps", "no coefficients"),
    ("rpcmag", "apply.steps", ["linearise", "subtract_offset", "sigma", "omega"], "apply.steps", "no coefficients"),
    ("tpf", "apply.steps", ["linearise", "subtract_offset", "sigma", "omega"], "linearisation", "together"),
    ("tcf", "linearisation", {"file": "L.toml"}, "linearisation", "together"),
    ("tpf", "apply.steps", ["sigma", "omega"], "apply.offset", "must stand together"),
    ("tof", "apply.steps", ["subtract_offset", "sigma", "omega"], "apply.omega", "must stand together"),
    ("tpf", "apply.omega", "swarm", "apply.omega", "neither `bepicolombo` nor `rosetta`"),
    ("tpf", "apply.omega_formula", make.ROSETTA, "apply.omega_formula", "which is not"),
    ("tpf", "apply.omega", "rosetta", "apply.omega_formula", "of the convention rosetta"),
    ("rpcmag", "apply.omega_formula", make.ROSETTA, "apply.omega_formula", "which is not"),
    ("tpf", "apply.q_formula", "Q = 1", "apply.q_formula", "not the one that is known"),
    ("tpf", "apply.offset", TWO, "apply.offset.acts", "not `before the matrix`"),
    ("tpf", "apply.offset.sign", "added", "apply.offset.sign", "not `subtracted`"),
    ("tpf", "apply.offset.unit", "nT", "apply.offset.unit", "not `enT`"),
    ("tpf", "apply.offset.quantity", "b_res", "apply.offset.quantity", "neither"),
    ("tpf", "apply.frame", None, "apply.frame", "is missing"),
    ("cpf", "apply.offset.quantity", "b_off", "apply.steps", "not how CPF files"),
    ("cpf", "apply.steps", ["linearise", "subtract_offset", "sigma", "omega", "rho", "r_nom"], "linearisation", "together"),
    ("cpf", "linearisation", {"file": "L.toml"}, "linearisation", "together"),
    ("cpf", "matrix.omega_convention", "Rosetta", "matrix.omega_convention", "contradicts"),
    ("cpf", "matrix.omega_convention", "other", "matrix.omega_convention", "neither"),
    ("cpf", "angle_deg", {"xi_xy": 90.2, "xi_xz": 89.7, "xi_yz": 89.95}, "matrix.omega", "not that of the angles"),
    ("cpf", "angle_deg", {"xi_xy": 10.0, "xi_xz": 10.0, "xi_yz": 170.0}, "angle_deg", "no three directions"),
    ("cpf", "angle_deg.xi_xz", None, "angle_deg.xi_xz", "is missing"),
    ("cpf", "matrix.phi_tilde", np.eye(3), "matrix.phi_tilde", "is not omega sigma"),
    ("cpf", "matrix.phi", np.eye(3), "matrix.phi", "is not r_nom rho omega sigma"),
    ("cpf", "matrix.rho", np.diag([1.0, 1.0, -1.0]), "matrix.rho", "is no rotation"),
    ("cpf", "matrix.rho", np.eye(3) * 1.001, "matrix.rho", "is no rotation"),
    ("cpf", "matrix.r_nom", np.ones((3, 3)), "matrix.r_nom", "is no rotation"),
    ("cpf", "matrix.sigma", np.diag([1.0, -1.0, 1.0]), "matrix.sigma", "must be positive"),
    ("cpf", "matrix.sigma", np.ones((3, 3)), "matrix.sigma", "must be diagonal"),
    ("cpf", "matrix.sigma", [1.0, 1.0, 1.0], "matrix.sigma", "has the shape [3], not [3, 3]"),
    ("cpf", "offset.b_or_ent", [1.0, float("nan"), 2.0], "offset.b_or_ent", "not determined"),
    ("cpf", "offset.b_or_ent", ["1", "2", "3"], "offset.b_or_ent", "must be numbers"),
    ("cpf", "std.sigma", [1.0, 2.0], "std.sigma", "must be 3 numbers"),
    ("cpf", "covariance", {"parameters": ["a", "b"], "matrix": [[1.0]]}, "covariance.matrix", "has the shape [1, 1], not [2, 2]"),
    ("tpf", "sigma_x", None, "sigma_x", "is missing"),
    ("tpf", "sigma_x", [], "sigma_x", "must be numbers"),
    ("tpf", "sigma_x", [-1.0, 0.0], "sigma_x, sigma_y, sigma_z", "must be positive"),
    ("tpf", "xi_xy", [0.0, 0.0], "xi_xy, xi_xz, xi_yz", "no three directions"),
    ("tpf", "valid_degc", None, "valid_degc", "is missing"),
    ("tpf", "valid_degc", [80.0, -40.0], "valid_degc", "must rise"),
    ("tpf", "covariance.sigma_x", [[1.0]], "covariance.sigma_x", "has the shape [1, 1], not [2, 2]"),
    ("tcf", "together", {"parameters": ["sigma_x.0"], "matrix": [[1.0]]}, "together.parameters", "lacks sigma_x.1"),
    ("rpcmag", "omega_convention", "BepiColombo", "omega_convention", "not `Rosetta`"),
    ("rpcmag", "omega_convention", None, "omega_convention", "is missing"),
    ("rpcmag", "offset_sign", "added", "offset_sign", "not `subtracted`"),
    ("rpcmag", "K_2", [0.0, 1e-3, 1.0], "K_1, K_2", "before the diagonal"),
    ("rpcmag", "SIGMA_00", [1.0, 2.0], "SIGMA_00", "has the shape [2], not [3]"),
    ("rpcmag", "A_1", None, "A_1", "is missing"),
    ("rpcmag", "covariance", {"parameters": ["A_0_x"], "matrix": [[NAN]]}, "covariance.matrix", "not determined"),
    ("rpcmag", "covariance", {"parameters": ["A_0_x"], "matrix": [[1.0, 2.0]]}, "covariance.matrix", "has the shape [1, 2]"),
    ("tpf", "valid_field_nt", [[-1.0, 1.0]], "valid_field_nt", "has the shape [1, 2], not [3, 2]"),
    ("tpf", "known_effects", "model.toml", "known_effects", "must be a list of texts"),
]


@pytest.mark.parametrize(("kind", "path", "value", "key", "rule"), FILES)
def test_a_file_is_refused(tmp_path, kind, path, value, key, rule):
    good = getattr(make, kind)()
    calfit.read(make.put(tmp_path, "GOOD", good))
    bad = make.put(tmp_path, "BAD", make.changed(good, path, value))
    refused(lambda: calfit.read(bad), "BAD", key, rule)


def test_a_ground_calibration_file_of_version_1_that_calfit_made(tmp_path):
    text = make.text(make.changed(make.rpcmag(), "version", 1), hashed=False)
    other = tmp_path / "OTHER.TXT"
    other.write_text(text)
    assert calfit.read(other).sensor == "FM 1"
    own = tmp_path / "OWN.TXT"
    own.write_text(text.replace('tool = "a test"', 'tool = "calfit"'))
    refused(lambda: calfit.read(own), "OWN.TXT", "version", "every misalignment has the wrong sign")


def test_a_file_that_was_changed(tmp_path):
    path = make.put(tmp_path, "A.CPF", make.cpf())
    calfit.read(path)
    path.write_text(path.read_text().replace("xi_xy = 89.8", "xi_xy = 89.9"))
    refused(lambda: calfit.read(path), "A.CPF", "provenance.content_sha256", "was changed after it was written")
    # The date is not part of it, nor are the ends of the lines; without a hash the file is read, with a note.
    path = make.put(tmp_path, "A.TPF", make.tpf())
    path.write_bytes(path.read_text().replace("2026-01-01", "2026-01-02").replace("\n", "\r\n").encode())
    assert calfit.read(path).notes[0].endswith("together")
    without = make.put(tmp_path, "B.TPF", make.tpf(), hashed=False)
    assert any("carries no hash" in note for note in calfit.read(without).notes)


def test_what_is_no_parameter_file(tmp_path):
    refused(lambda: calfit.read(tmp_path / "NONE.CPF"), "NONE.CPF", "", "cannot be read")
    contents = ((b"a = [", "is not TOML"), (b'{ "a": ', "is not JSON"), (b"\xff\xfe", "is not UTF-8"), (b"a = 1", "is missing"))
    for content, rule in contents:
        path = tmp_path / "A.CPF"
        path.write_bytes(content)
        with pytest.raises(calfit.Refused, match=rule):
            calfit.read(path)


def test_files_that_do_not_belong_together(tmp_path):
    def at(name, document):
        return make.put(tmp_path, name, document)

    tpf, tof, opf, cpf = (at(f"GOOD.{k}", getattr(make, k)()) for k in ("tpf", "tof", "opf", "cpf"))
    tcf = at("GOOD.tcf", make.tcf())
    other = at("OTHER.tof", make.changed(make.tof(), "sensor", "FM 2"))
    refused(lambda: calfit.read(tpf, other), "OTHER.tof", "sensor", "is `FM 2`, that of")
    other = at("OTHER.tof", make.changed(make.tof(), "mode", "fast"))
    refused(lambda: calfit.read(tpf, other), "OTHER.tof", "mode", "is `fast`, that of")
    other = at("OTHER.opf", make.changed(make.opf(), "run.sensor", "FM 2"))
    refused(lambda: calfit.read(tpf, other), "OTHER.opf", "sensor", "is `FM 2`, that of")
    other = at("OTHER.tof", make.changed(make.tof(), "channel", "T60"))
    refused(lambda: calfit.read(tpf, other), "OTHER.tof", "channel", "is `T60`, that of")
    other = at("OTHER.OPF", make.opf() | {"conditions": {"sensor_channel": "T60", "sensor_degc": [20.0, 20.0, 20.0]}})
    refused(lambda: calfit.read(tpf, other), "OTHER.OPF", "conditions.sensor_channel", "is `T60`, that of")
    refused(lambda: calfit.read(tpf, tof, opf), "GOOD.opf", "format", "a second offset")
    refused(lambda: calfit.read(cpf, opf), "GOOD.opf", "format", "a second offset")
    refused(lambda: calfit.read(tcf, tof), "GOOD.tof", "format", "a second offset")
    refused(lambda: calfit.read(tpf, cpf), "GOOD.cpf", "format", "a second calibration")
    refused(lambda: calfit.read(opf, tof), "GOOD.tof", "format", "a second offset")
    refused(lambda: calfit.read(tpf, sensor="FM 2"), "GOOD.tpf", "sensor", "is `FM 1`, not `FM 2`")
    refused(lambda: calfit.read(cpf, mode="fast"), "GOOD.cpf", "mode", "is `science`, not `fast`")
    # No temperature at which both hold.
    warm = at("WARM.tof", make.changed(make.tof(), "valid_degc", [80.1, 90.0]))
    refused(lambda: calfit.read(tpf, warm), "WARM.tof", "valid_degc", "covers 80.1 to 90.0 degC, ")
    # In any order.
    np.testing.assert_array_equal(calfit.read(tof, tpf).apply(*RAW, 5.0)[0], calfit.read(tpf, tof).apply(*RAW, 5.0)[0])


def test_what_is_missing_is_told_when_it_is_needed(tmp_path):
    p = calfit.read(make.put(tmp_path, "A.TOF", make.tof()))
    refused(lambda: p.apply(*RAW, 5.0), "A.TOF", "format", "an offset without sigma and omega; name a TPF")
    tpf = make.put(tmp_path, "A.TPF", make.tpf())
    part = make.put(tmp_path, "PART.TOF", make.changed(make.tof(), "b_off_y", None))
    p = calfit.read(tpf, part)
    assert "b_off_x" in p.values and p.offset is None
    refused(lambda: p.apply(*RAW, 5.0), "PART.TOF", "b_off_y", "is missing")
    # Files have nan for a component that was not determined.
    unknown = make.changed(make.changed(make.tof(), "b_off_y", [np.nan]), "covariance.b_off_y", [[np.nan]])
    p = calfit.read(tpf, make.put(tmp_path, "NAN.TOF", unknown))
    assert "b_off_x" in p.values and "b_off_y" not in p.values and p.offset is None
    refused(lambda: p.apply(*RAW, 5.0), "NAN.TOF", "b_off_y", "is missing")
    tcf = make.tcf() | {"apply": make.apply("rosetta", None)}
    p = calfit.read(make.put(tmp_path, "A.TCF", tcf))
    refused(lambda: p.apply(*RAW, 5.0), "A.TCF", "apply.offset", "has no offset")


@pytest.mark.parametrize(
    ("kind", "table"),
    [
        ("cpf", {"model": {"file": "model.toml", "effect": [{"id": "cubic_nonlinearity"}]}}),
        ("cpf", {"model": {"file": "model.toml"}}),
        ("tpf", {"sweep": {"model": {"file": "model.toml", "effect": [{"id": "cubic_nonlinearity"}]}}}),
        ("tpf", {"known_effects": ["other.toml", "model.toml"]}),
        ("tcf", {"known_effects": ["model.toml"]}),
        ("rpcmag", {"known_effects": ["model.toml"]}),
    ],
)
def test_effects_that_were_taken_off(tmp_path, kind, table):
    p = calfit.read(make.put(tmp_path, "A.toml", getattr(make, kind)() | table))
    with pytest.raises(calfit.Refused, match=r"effects of .*model\.toml were taken off the readings"):
        p.apply(*RAW, 5.0)
    plain = calfit.read(make.put(tmp_path, "B.toml", getattr(make, kind)()))
    np.testing.assert_array_equal(p.apply(*RAW, 5.0, effects_taken_off=True)[0], plain.apply(*RAW, 5.0)[0])


def test_a_model_among_the_inputs_of_polynomials(tmp_path):
    path = make.put(tmp_path, "A.TPF", make.tpf(), hashed=False)
    path.write_text(path.read_text().replace("[provenance]", '[provenance]\ninput = [{ path = "model.toml", role = "model" }]'))
    refused(lambda: calfit.read(path).apply(*RAW, 5.0), "A.TPF", "provenance.input", "known effects")


INPUTS = [
    ({"y": [1.0, 2.0]}, "y", "has the shape (2,), x (3,)"),
    ({"t_degc": [1.0, 2.0]}, "t_degc", "has the shape (2,), x (3,)"),
    ({"x": ["a", "b", "c"]}, "x", "is of type"),
    ({"x": [1.0, 2.0, None]}, "x", "is of type object"),
    ({"x": [1.0j, 2.0, 3.0]}, "x", "is of type complex"),
    ({"z": [True, False, True]}, "z", "is of type bool"),
    ({"z": [[1.0], [2.0, 3.0], [4.0]]}, "z", "differ in length"),
    ({"frame": "moon"}, "frame", "is `moon`"),
    ({"frame": "coil"}, "frame", "no rotation to coil axes is stated"),
    ({"outside": "raise"}, "outside", "is `raise`"),
    ({"frame": "reference"}, "rotation", "is missing, and the file states none"),
    ({"rotation": np.eye(3)}, "rotation", "does not belong"),
    ({"frame": "reference", "rotation": np.eye(3) * 1.001}, "rotation", "is no rotation"),
    ({"frame": "reference", "rotation": np.diag([1.0, 1.0, -1.0])}, "rotation", "is no rotation"),
    ({"frame": "reference", "rotation": np.eye(2)}, "rotation", "is no rotation"),
    ({"frame": "reference", "rotation": np.full((3, 3), NAN)}, "rotation", "is no rotation"),
    ({"frame": "reference", "rotation": np.eye(3), "rotation_std_deg": -1.0}, "rotation_std_deg", "from zero on"),
]


@pytest.mark.parametrize(("changed", "key", "rule"), INPUTS)
def test_an_input_is_refused(tmp_path, changed, key, rule):
    p = calfit.read(make.put(tmp_path, "A.TPF", make.tpf()))
    given = {"x": [1.0, 2.0, 3.0], "y": [1.0, 2.0, 3.0], "z": [1.0, 2.0, 3.0], "t_degc": 20.0}
    p.apply(**given)
    refused(lambda: p.apply(**(given | changed)), "A.TPF", key, rule)
