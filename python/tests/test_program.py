"""Files that the program made of a simulated campaign whose truth is known. `CALFIT_FILES` names their folder, `CALFIT_KINDS` the kinds
that the program knows."""

import json
import os
import tomllib
from pathlib import Path

import calfit
import make
import numpy as np
import pytest
from calfit.kinds import KINDS

FOLDER = os.environ.get("CALFIT_FILES")
if not FOLDER:
    pytest.skip("CALFIT_FILES names no folder with files of the program", allow_module_level=True)

#: The twin that the campaign was simulated of.
TWIN = tomllib.loads((Path(__file__).parents[2] / "tests/data/version-1/twin/campaign.toml").read_text())["sensor"][0]
FIELDS = np.array([(1500.0, 0.0, 0.0), (0.0, -1500.0, 0.0), (0.0, 0.0, 1500.0), (800.0, 900.0, -1000.0), (0.0, 0.0, 0.0)])
TEMPERATURES = (-40.0, -10.0, 20.0, 50.0, 79.9)


def files(pattern):
    found = sorted(Path(FOLDER).glob(pattern))
    assert found, pattern
    return found


def one(pattern):
    (found,) = files(pattern)
    return found


def true_readings(t, offset="b_off"):
    sigma, xi = (make.at(TWIN, stem, t) for stem in ("sigma", "xi"))
    return np.array([make.reading(f, sigma, xi, make.at(TWIN, offset, t)) for f in FIELDS]).T


def test_the_kinds_are_those_of_the_program():
    known = os.environ["CALFIT_KINDS"].split()
    # Ground calibration files are exported, not written by an analysis.
    assert set(KINDS) == {*known, "RPCMAG"}


def test_every_file_of_the_program_is_read():
    formats = set()
    for path in Path(FOLDER).rglob("*"):
        named = path.name.removesuffix(".json")
        if (
            named.endswith((".CPF", ".OPF", ".FPF", ".TPF", ".TOF", ".TAF", ".TCF", ".TXT"))
            or named.startswith(("LINEARISATION__", "THERMISTOR__", "NULL_PARAMETER__", "COIL_"))
            and named.endswith(".toml")
        ):
            p = calfit.read(path)
            assert p.values and p.units, path
            # The hash that the program wrote is the one that is found here.
            assert path.suffix == ".json" or not any("hash" in note for note in p.notes), path
            formats.add(p.format)
    wanted = {
        "CPF",
        "OPF",
        "FPF",
        "TPF",
        "TOF",
        "TAF",
        "TCF",
        "RPCMAG",
        "LINEARISATION",
        "THERMISTOR",
        "NULL",
        "COIL_SCALAR",
        "COIL_RESIDUAL",
    }
    assert formats >= wanted


@pytest.mark.parametrize("pair", ["TPF + TOF", "TCF", "RPCMAG"])
def test_the_true_field_comes_back_within_its_uncertainty(pair):
    if pair == "TPF + TOF":
        p = calfit.read(one("thermal/*.TPF"), one("thermal/*.TOF"), sensor="FGM", mode="science")
    elif pair == "TCF":
        p = calfit.read(one("centre/*.TCF"))
    else:
        p = calfit.read(one("rpcmag/*.TXT"))
    assert p.offset == "b_off"
    for t in TEMPERATURES:
        b, u, flags = p.apply(*true_readings(t), t)
        assert not flags.any()
        wanted = FIELDS
        if p.format != "TPF+TOF":
            # In the other convention the matrix is upper triangular, and makes vectors of the same lengths and angles.
            transfer = np.linalg.inv(make.axes(make.at(TWIN, "xi", t))) * make.at(TWIN, "sigma", t)
            turn = np.linalg.cholesky(transfer.T @ transfer).T @ np.linalg.inv(transfer)
            wanted = FIELDS @ turn.T
        # Six standard uncertainties: they are of type A, and few runs determine the polynomials.
        assert (np.abs(b - wanted) < 6.0 * u).all(), (t, b - wanted, u)


def test_runs_are_applied_as_their_matrices_say():
    for path in files("thermal/*/*.CPF") + files("linearise/*/*.CPF"):
        p = calfit.read(path)
        stated = tomllib.loads(path.read_text())
        raw = np.array([[1000.0, -700.0, 30.0], [0.0, 0.0, 0.0], [1.0, 900.0, -1100.0]])
        linear = raw
        if "linearisation" in stated:
            of = stated["linearisation"]["applied"]
            linear = raw + np.array(of["c2_per_ent"]) * raw**2 + np.array(of["c3_per_ent2"]) * raw**3
        without = linear - np.array(stated["offset"]["b_or_ent"])
        for frame, matrix in (("sensor", "phi_tilde"), ("coil", "phi")):
            b, u, _ = p.apply(*raw.T, frame=frame)
            np.testing.assert_allclose(b, without @ np.array(stated["matrix"][matrix]).T, rtol=0, atol=1e-9)
            # Where readings are those of zero field, the uncertainty is that of the offset.
            zero = [p.apply(*np.array(stated["offset"]["b_or_ent"]), frame=frame)[1]] if "linearisation" not in stated else []
            for at_zero in zero:
                m, c = np.array(stated["matrix"][matrix]), np.array(stated["covariance"]["matrix"])[9:, 9:]
                np.testing.assert_allclose(at_zero, np.sqrt(np.diagonal(m @ c @ m.T)), rtol=1e-9)
        # Standard uncertainties of the matrix that the program carried through the split itself, one reading at a time.
        for column in range(3):
            if "linearisation" in stated:
                continue
            size = 1e9
            reading = np.array(stated["offset"]["b_or_ent"])
            reading[column] += size
            for frame, matrix in (("sensor", "phi_tilde"), ("coil", "phi")):
                u = p.apply(*reading, frame=frame)[1] / size
                np.testing.assert_allclose(u, np.array(stated["std"][matrix])[:, column], rtol=1e-6, atol=1e-10)


def test_json_twins_of_the_program_say_the_same():
    for path in files("json/*.json"):
        name = path.name.removesuffix(".json")
        (own,) = [p for folder in ("thermal", "centre") for p in (Path(FOLDER) / folder).rglob(name)]
        twin, parameters = calfit.read(path), calfit.read(own)
        assert twin.values.keys() == parameters.values.keys()
        for name, value in parameters.values.items():
            np.testing.assert_array_equal(twin.values[name], value)
        if parameters.format in ("CPF", "TPF", "TCF"):
            for a, b in zip(twin.apply(10.0, 20.0, 30.0, 20.0), parameters.apply(10.0, 20.0, 30.0, 20.0)):
                np.testing.assert_array_equal(a, b)
    document = json.loads(files("json/*.TCF.json")[0].read_text())
    assert document["written_by"].startswith("calfit")


def test_how_a_sensor_stands_in_its_reference_cube():
    # Stated for the frame of the BepiColombo convention; in files of the other one the frame is another.
    stated = np.array([[0.0, 0.6, 0.8], [0.0, -0.8, 0.6], [1.0, 0.0, 0.0]])
    readings = true_readings(20.0)
    tpf = calfit.read(one("thermal/THERMAL_PARAMETER__*.TPF"), one("thermal/*.TOF"))
    b, u, _ = tpf.apply(*readings, 20.0, frame="reference")
    assert (np.abs(b - FIELDS @ stated.T) < 6.0 * u).all()
    for other in (calfit.read(one("centre/*.TCF")), calfit.read(one("rpcmag/*.TXT"))):
        found, uncertainty, _ = other.apply(*readings, 20.0, frame="reference")
        assert (np.abs(found - FIELDS @ stated.T) < 6.0 * uncertainty).all()
        assert np.abs(other.apply(*readings, 20.0)[0] @ stated.T - found).max() > 1.0


def test_a_run_from_which_effects_were_taken_off_is_not_applied_to_raw_readings():
    p = calfit.read(one("model/*/*.CPF"))
    with pytest.raises(calfit.Refused, match=r"effects of model\.toml were taken off"):
        p.apply(1.0, 2.0, 3.0)


#: What the program applied to readings inside and outside of what was calibrated.
APPLIED = {case["name"]: case for case in json.loads((Path(FOLDER) / "applied" / "cases.json").read_text())}


def test_every_kind_is_among_what_the_program_applied():
    kinds = {calfit.read(*(Path(FOLDER) / file for file in case["files"])).format for case in APPLIED.values()}
    assert kinds == {"CPF", "TPF", "TPF+TOF", "TPF+OPF", "TCF", "TCF+TOF", "RPCMAG"}


def calibrated(folder):
    """Readings, temperatures, field, uncertainty and flags of a table that the program wrote; nan for an empty cell."""
    lines = (Path(FOLDER) / "applied" / folder / "raw.calibrated.csv").read_text().splitlines()
    assert lines[0].startswith("# calfit {")
    columns = lines[1].split(",")
    cells = [[float(cell) if cell else np.nan for cell in line.split(",")] for line in lines[2:]]
    rows = {name: np.array([row[i] for row in cells]) for i, name in enumerate(columns)}
    three = lambda *names: np.stack([rows[name] for name in names], axis=1)  # noqa: E731
    b, u = three("bx_nt", "by_nt", "bz_nt"), three("u_bx_nt", "u_by_nt", "u_bz_nt")
    return three("x", "y", "z"), rows["t_degc"], b, u, rows["flags"].astype(np.uint32)


@pytest.mark.parametrize("name", APPLIED)
def test_the_package_and_the_program_are_one(name):
    case = APPLIED[name]
    p = calfit.read(*(Path(FOLDER) / file for file in case["files"]))
    options = {"frame": case["frame"], "effects_taken_off": case["effects_taken_off"]}
    for folder, outside in ((name, "flag"), (f"{name}.null", "null")):
        readings, t, b, u, flags = calibrated(folder)
        found, uncertainty, bits = p.apply(*readings.T, t, outside=outside, **options)
        np.testing.assert_array_equal(bits, flags)
        np.testing.assert_array_equal(np.isnan(found), np.isnan(b))
        # Of the field, not of a component that happens to be small.
        size = np.abs(b).max(axis=1, keepdims=True)
        given = ~np.isnan(size[:, 0])
        assert given.any() and (np.abs(found - b)[given] <= 1e-12 * size[given]).all()
        np.testing.assert_allclose(uncertainty, u, rtol=1e-9)
        stated = given & ((flags & calfit.TEMPERATURE) == 0)
        assert stated.any() and (u[stated] > 0.0).all()
        # Readings of every kind are among them, and the bits say which.
        for bit in (calfit.TEMPERATURE, calfit.FIELD, calfit.NO_TEMPERATURE):
            assert ((flags & bit) != 0).any()
        assert (flags == 0).any()
    with pytest.raises(calfit.Refused):
        p.apply(*readings.T, t, outside="error", **options)
    inside = flags == 0
    np.testing.assert_array_equal(p.apply(*readings[inside].T, t[inside], outside="error", **options)[0], found[inside])
