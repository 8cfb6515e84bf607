"""CDF files of levels as calfit writes them, read back."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

cdflib = pytest.importorskip("cdflib", reason="the package cdflib is not there")
pa = pytest.importorskip("pyarrow", reason="the package pyarrow is not there")
np = pytest.importorskip("numpy", reason="the package numpy is not there")
pq = pytest.importorskip("pyarrow.parquet")

TOOL = Path(__file__).parents[1] / "parquet2cdf.py"
#: From 2015-06-30T23:59:59.5 on, through the leap second.
TIMES = [488_980_866_684_000_000 + k * 500_000_000 for k in range(5)]
LABELS = [[2015, 6, 30, 23, 59, 59, 500], [2015, 6, 30, 23, 59, 60, 0], [2015, 6, 30, 23, 59, 60, 500]]
SAYS = {
    "level": "C",
    "mission": "Rosetta (simulated)",
    "instrument": "RPC-MAG",
    "sensor": "OB",
    "day": "2015-06-30",
    "frame": "ECLIPJ2000",
    "inputs": json.dumps([{"path": "flight.toml", "size_bytes": 7, "sha256": "ab" * 32}]),
    "notes": json.dumps(["a note"]),
    "written_by": "calfit 0.1.0",
}


def level(path, says=SAYS, **more):
    field = [1.25, None, -3e-5, 1e4 / 3, 0.1]
    columns = {
        "time_tt2000": pa.array(TIMES, pa.int64()),
        "time_utc": pa.array([1435708799_500_000_000] * 5, pa.timestamp("ns", tz="UTC")),
        "time_obt": pa.array([3.9e8 + k / 2 for k in range(5)]),
        **{f"b{c}": pa.array([None if v is None else v * s for v in field]) for c, s in zip("xyz", (1, -1, 3), strict=True)},
        **{f"position_{c}_km": pa.array([1e8 / 3, 2e8, 3e8, 4e8, None]) for c in "xyz"},
        "sid": pa.array(["SID3", "SID2", "SID3", "SID10", "SID3"]).dictionary_encode(),
        **{f"{u}_{c}": pa.array([0.03, None, 0.1, 0.2, 0.3], pa.float32()) for u in ("ua", "uc") for c in "xyz"},
        "quality": pa.array([0, 1, 2, 0, 8], pa.uint8()),
        "flags": pa.array([0, 8, 16, 1 << 17, 0], pa.uint32()),
    }
    table = pa.table(columns | more).replace_schema_metadata(says)
    pq.write_table(table, path)
    return path, table


def run(*arguments):
    return subprocess.run([sys.executable, TOOL, *map(str, arguments)], capture_output=True, text=True)


def test_every_number_comes_back(tmp_path):
    path, table = level(tmp_path / "level.parquet")
    done = run(path, "-o", tmp_path / "cdf", "--attribute", "PI_name=A. Person")
    assert done.returncode == 0, done.stderr
    name = "rosetta-simulated_lc_rpc-mag-ob_20150630_v01"
    assert [p.name for p in (tmp_path / "cdf").iterdir()] == [f"{name}.cdf"]
    cdf = cdflib.CDF(tmp_path / "cdf" / f"{name}.cdf", validate=True)
    stated = cdf.globalattsget()
    assert (stated["Logical_file_id"], stated["PI_name"], stated["Parents"]) == (
        [name],
        ["A. Person"],
        ["flight.toml sha256 " + "ab" * 32],
    )
    assert "a note" in stated["TEXT"] and "frame: ECLIPJ2000" in stated["TEXT"]

    assert cdf.varinq("Epoch").Data_Type_Description == "CDF_TIME_TT2000"
    epoch = cdf.varget("Epoch")
    assert epoch.tolist() == TIMES
    # The labels are those of UTC with its leap second.
    assert [list(row[:7]) for row in cdflib.cdfepoch.breakdown(epoch)[:3]] == LABELS
    columns = {"B": ["bx", "by", "bz"], "ua": ["ua_x", "ua_y", "ua_z"], "position": [f"position_{c}_km" for c in "xyz"]}
    for variable, names in columns.items():
        found = cdf.varget(variable)
        for k, column in enumerate(names):
            values = table[column].to_pylist()
            fill = found.dtype.type(-1e31)
            assert found[:, k].tolist() == [fill.item() if v is None else v for v in values], column
    assert cdf.varget("time_obt").tolist() == table["time_obt"].to_pylist()
    assert cdf.varget("flags").tolist() == table["flags"].to_pylist()
    assert cdf.varget("quality").tolist() == table["quality"].to_pylist()
    assert [str(word).strip() for word in cdf.varget("sid")] == table["sid"].to_pylist()


def test_every_variable_has_what_istp_asks_for(tmp_path):
    path, _ = level(tmp_path / "level.parquet")
    assert run(path, "-o", tmp_path).returncode == 0
    cdf = cdflib.CDF(next(tmp_path.glob("*.cdf")))
    for variable in cdf.cdf_info().zVariables:
        about, kind = cdf.varattsget(variable), cdf.varinq(variable)
        wanted = {"CATDESC", "FIELDNAM", "VAR_TYPE", "FORMAT"}
        if kind.Rec_Vary and "CHAR" not in kind.Data_Type_Description:
            wanted |= {"UNITS", "FILLVAL", "VALIDMIN", "VALIDMAX"}
            assert np.asarray(about["FILLVAL"]).dtype == cdf.varget(variable).dtype
        if kind.Rec_Vary and variable != "Epoch":
            wanted |= {"DEPEND_0", "DISPLAY_TYPE"}
            assert about["DEPEND_0"] == "Epoch"
        if kind.Rec_Vary and kind.Dim_Sizes:
            wanted.add("LABL_PTR_1")
            labels = cdf.varget(about["LABL_PTR_1"])
            assert labels.shape == (3,) and cdf.varattsget(about["LABL_PTR_1"])["VAR_TYPE"] == "metadata"
        assert wanted <= set(about), (variable, wanted - set(about))
        assert len(about["CATDESC"]) <= 80
    assert cdf.varattsget("B")["COORDINATE_SYSTEM"] == "ECLIPJ2000"
    wanted = {
        "Project",
        "Source_name",
        "Discipline",
        "Data_type",
        "Descriptor",
        "Data_version",
        "Logical_file_id",
        "Logical_source",
    }
    wanted |= {
        "Logical_source_description",
        "Instrument_type",
        "Mission_group",
        "PI_name",
        "PI_affiliation",
        "TEXT",
        "Generated_by",
    }
    assert wanted <= set(cdf.globalattsget())


def test_equal_levels_give_equal_bytes(tmp_path):
    path, _ = level(tmp_path / "level.parquet")
    for folder in ("a", "b"):
        assert run(path, "-o", tmp_path / folder).returncode == 0
    first, second = (next((tmp_path / folder).glob("*.cdf")).read_bytes() for folder in ("a", "b"))
    assert first == second


def test_what_cannot_be_written_is_named_and_the_others_are_written(tmp_path):
    good, _ = level(tmp_path / "good.parquet")
    foreign, _ = level(tmp_path / "foreign.parquet", says={"level": "C"})
    silent, _ = level(tmp_path / "silent.parquet", says={k: v for k, v in SAYS.items() if k != "mission"})
    strange, _ = level(tmp_path / "strange.parquet", more=pa.array([[1]] * 5))
    (tmp_path / "cut.parquet").write_bytes(good.read_bytes()[:1000])
    out = tmp_path / "out"
    done = run(foreign, silent, strange, tmp_path / "cut.parquet", good, "-o", out)
    assert done.returncode == 1
    errors = done.stderr.splitlines()
    assert len(errors) == 4 and all(
        name in error for name, error in zip(("foreign", "silent", "strange", "cut"), errors, strict=True)
    )
    assert "--say mission=" in errors[1]
    assert len(list(out.iterdir())) == 1
    assert run(silent, "-o", out, "--say", "mission=Other").returncode == 0
    assert sorted(p.name.split("_")[0] for p in out.iterdir()) == ["other", "rosetta-simulated"]
