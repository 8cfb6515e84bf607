"""Values, units, uncertainties and covariances of every kind, also of files that are not applied."""

import math
from pathlib import Path

import calfit
import make
import numpy as np
import pytest
from calfit.steps import FRAMES

#: Files of all kinds that the first version of the program made; they go with the project.
OLD = Path(__file__).parents[2] / "tests" / "data" / "version-1" / "files"


def old(pattern):
    if not OLD.is_dir():
        pytest.skip("the files of version 1 are not beside the package")
    (found,) = OLD.glob(pattern)
    return calfit.read(found)


def test_a_run(tmp_path):
    p = calfit.read(make.put(tmp_path, "A.CPF", make.cpf()))
    assert (p.format, p.sensor, p.mode) == ("CPF", "FM 1", "science")
    np.testing.assert_array_equal(p.values["matrix.sigma"], np.diag(make.SIGMA))
    np.testing.assert_array_equal(p.std["matrix.sigma"], np.diag([1e-5, 2e-5, 3e-5]))
    assert (p.values["angle_deg.xi_xz"], p.std["angle_deg.xi_xz"]) == (90.3, 2e-3)
    assert (p.units["matrix.sigma"], p.units["angle_deg.xi_xz"], p.units["offset.b_or_ent"]) == ("nT/enT", "deg", "enT")
    assert p.frame == "sensor (bepicolombo)"
    assert p.documents[0].get("run.id") == "26-01-01_00-00-00"


def test_what_a_file_holds_for_and_how_its_sensor_stands(tmp_path):
    limits = [[-1.0, 2.0], [-3.0, 4.0], [-5.0, 6.0]]
    document = make.tpf() | {"valid_field_nt": limits, "location": "off-centre"}
    p = calfit.read(make.put(tmp_path, "A.TPF", document))
    assert p.values["valid_field_nt"].tolist() == limits and p.units["valid_field_nt"] == "nT"
    assert any("beside the centre" in note and "apply the TCF" in note for note in p.notes)
    cpf = make.changed(make.cpf(), "valid", {"field_coil_nt": limits, "temperature_degc": [19.0, 20.0]})
    cpf["reference"] = {"rotation": make.RHO, "std_deg": 0.1, "from": FRAMES["bepicolombo"]}
    p = calfit.read(make.put(tmp_path, "A.CPF", cpf))
    assert p.values["valid.field_coil_nt"].tolist() == limits and p.values["valid.temperature_degc"].tolist() == [19.0, 20.0]
    np.testing.assert_array_equal(p.values["reference.rotation"], make.RHO)
    assert (p.values["reference.std_deg"], p.units["reference.std_deg"]) == (0.1, "deg")
    assert not any("beside the centre" in note for note in p.notes)


def test_polynomials_with_their_covariance(tmp_path):
    p = calfit.read(make.put(tmp_path, "A.TPF", make.tpf()), make.put(tmp_path, "A.TOF", make.tof()))
    assert p.format == "TPF+TOF"
    assert p.values["sigma_y"].tolist() == [1.02, -1.6e-5, 2e-8] and p.units["sigma_y"] == "nT/enT"
    assert p.values["b_off_x"].tolist() == [2.5, 0.02] and p.values["b_or_x"].tolist() == [12.5, 0.05]
    covariance = p.covariance["sigma_y"]
    assert covariance.parameters == ("sigma_y.0", "sigma_y.1", "sigma_y.2")
    assert covariance.units == ("nT/enT", "nT/enT/degC^1", "nT/enT/degC^2")
    np.testing.assert_allclose(covariance.matrix[0], [1e-10, -5e-12, 2.5e-13])
    np.testing.assert_allclose(p.std["sigma_y"], [1e-5, 1e-6, 1e-7])
    # What stands in both files.
    assert p.values["valid_degc"].tolist() == p.values["TOF.valid_degc"].tolist() == [-40.0, 80.0]


def test_an_offset_with_a_component_that_is_not_determined(tmp_path):
    p = calfit.read(make.put(tmp_path, "A.OPF", make.opf()))
    assert p.values["offset_ent"].tolist() == [2.0, -3.0, 4.0] and p.std["offset_ent"].tolist() == [0.1, 0.2, 0.3]
    assert math.isnan(p.values["residual_ent"][0]) and p.units["residual_ent"] == "enT"


# Numbers as they stand in the files.
KINDS = [
    ("lin/*.CPF", "angle_deg.xi_xy", 89.78628610228115, "deg", 0.0017171282281100051),
    ("lin/*.CPF", "run.temperature_degc", 20.0085, "degC", None),
    ("freq/*.FPF", "mean_f_s_hz", None, "Hz", None),
    ("thermal/*.TAF", "f_3db_x", None, "Hz", None),
    ("thermistor/*", "reference.offset_degc", 0.084785730529553058, "degC", 0.14704758205314700),
    ("linearise/LINEARISATION*", "linearisation.c2_per_ent", None, "1/enT", None),
    (
        "scalar/*",
        "facility.scale_nt_per_eu",
        [1.0000018573048974, 0.9999979618759538, 0.9999967738155386],
        "nT/EU",
        [1.8818086161997419e-6, 1.8023817318887243e-6, 1.7229405805127364e-6],
    ),
    ("scalar/*", "facility.offset_nt", [-0.361026022190658, 0.21049259791669356, -6.938207273053807], "nT", None),
    ("tilt/*", "facility.angles_deg", None, "deg", None),
    ("residual/*", "facility.offset_nt", [-0.43000000000029104, 0.24499999999898137, -6.970000000001164], "nT", None),
    ("null/*", "offset.mean_ent", None, "enT", None),
    ("null/*", "density.ent_per_root_hz", None, "enT/sqrt(Hz)", None),
]


@pytest.mark.parametrize(("pattern", "name", "value", "unit", "std"), KINDS)
def test_files_of_other_kinds(pattern, name, value, unit, std):
    p = old(pattern)
    assert name in p.values, sorted(p.values)
    assert p.units[name] == unit
    assert np.isfinite(np.asarray(p.values[name])).all()
    if value is not None:
        np.testing.assert_array_equal(p.values[name], value)
    if std is not None:
        np.testing.assert_array_equal(p.std[name], std)


NOT_APPLIED = {
    "freq/*.FPF": "frequency response",
    "thermal/*.TAF": "-3 dB frequencies",
    "thermal/*.TOF": "without sigma and omega",
    "thermal/*.OPF": "without sigma and omega",
    "thermistor/*": "turns a signal into a temperature",
    "linearise/LINEARISATION*": "linearises readings",
    "null/*": "drift and noise",
    "scalar/*": "of the coil system",
    "residual/*": "residual field of the coil system",
    "tilt/*": "corrections of the coil system",
}


@pytest.mark.parametrize("pattern", NOT_APPLIED)
def test_what_takes_no_reading_to_a_field_says_what_is_missing(pattern):
    with pytest.raises(calfit.Refused, match=NOT_APPLIED[pattern]) as caught:
        old(pattern).apply(1.0, 2.0, 3.0, 20.0)
    assert caught.value.key == "format" and "name a" in str(caught.value)


def test_a_model_names_its_parameters(tmp_path):
    parameter = {"name": "c3_x", "value": 1.4e-10, "std": 8.8e-12, "unit": "enT/enT^3"}
    model = {"format": "MODEL", "version": 1, "used": ["A"], "effect": [{"id": "cubic_nonlinearity", "parameter": [parameter]}]}
    p = calfit.read(make.put(tmp_path, "model.toml", model))
    name = "effect.0.parameter.c3_x"
    assert (p.values[name], p.std[name], p.units[name]) == (1.4e-10, 8.8e-12, "enT/enT^3")
    with pytest.raises(calfit.Refused, match="effects beside the linear sensor"):
        p.apply(1.0, 2.0, 3.0)


def test_files_of_version_1_are_read_by_their_rules_or_refused_with_the_reason():
    p = old("report/*.CPF")
    raw = np.array([100.0, 200.0, -300.0])
    stated = p.documents[0].data
    wanted = np.array(stated["matrix"]["phi"]) @ (raw - np.array(stated["offset"]["b_or_ent"]))
    np.testing.assert_allclose(p.apply(*raw, frame="coil")[0], wanted, rtol=1e-12)
    for pattern in ("centre/*.TCF", "rpcmag/*.TXT"):
        with pytest.raises(calfit.Refused, match="every misalignment has the wrong sign"):
            old(pattern)
    t = 35.0
    p = old("thermal/*.TPF")
    at = lambda name: np.polyval(p.documents[0].data[name][::-1], t)  # noqa: E731
    sigma, xi, offset = (
        [at(f"{stem}_{c}") for c in of] for stem, of in (("sigma", "xyz"), ("xi", ("xy", "xz", "yz")), ("b_or", "xyz"))
    )
    # What the sensor reads comes back.
    field = [1000.0, -2000.0, 3000.0]
    np.testing.assert_allclose(p.apply(*make.reading(field, sigma, xi, offset), t)[0], field, rtol=1e-12)


def test_a_part_that_goes_after_the_thermistor_is_told(tmp_path):
    late = make.tpf() | {"thermistor_lag": {"form": "delay", "lag_s": 480.0}}
    notes = calfit.read(make.put(tmp_path, "L.TPF", late)).notes
    assert any("goes after the thermistor with a delay of 480.0 s" in note for note in notes)
    assert not any("thermistor" in note for note in calfit.read(make.put(tmp_path, "A.TPF", make.tpf())).notes)
