"""Attitude and positions from kernels that are made here, of which every quaternion has a closed form."""

import json
import math
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import pytest

spiceypy = pytest.importorskip("spiceypy", reason="the package spiceypy is not there")
pq = pytest.importorskip("pyarrow.parquet", reason="the package pyarrow is not there")
np = pytest.importorskip("numpy", reason="the package numpy is not there")

TOOL = Path(__file__).parents[1] / "ck2table.py"
#: 2015-07-01T00:00:00 UTC: 5660 days after 2000-01-01 less half a day, with 36 leap seconds and 32.184 s.
JULY = (5660 * 86_400 - 43_200 + 36) * 10**9 + 32_184_000_000
OBLIQUITY = math.radians(84381.448 / 3600)
#: Turns of the spacecraft and of the body, rad/s.
CK_RATE = 2e-3
BODY_DEG_PER_DAY = 36000.0

LSK = r"""KPL/LSK
\begindata
DELTET/DELTA_T_A = 32.184
DELTET/K = 1.657D-3
DELTET/EB = 1.671D-2
DELTET/M = ( 6.239996D0 1.99096871D-7 )
DELTET/DELTA_AT = ( 32, @1999-JAN-1 33, @2006-JAN-1 34, @2009-JAN-1 35, @2012-JUL-1 36, @2015-JUL-1 )
\begintext
"""
FRAMES = r"""KPL/FK
\begindata
FRAME_FIXED = -999001
FRAME_-999001_NAME = 'FIXED'
FRAME_-999001_CLASS = 4
FRAME_-999001_CLASS_ID = -999001
FRAME_-999001_CENTER = -999
TKFRAME_-999001_RELATIVE = 'ECLIPJ2000'
TKFRAME_-999001_SPEC = 'QUATERNION'
TKFRAME_-999001_Q = ( 0.5 -0.5 0.5 0.5 )
FRAME_TURNING = -999000
FRAME_-999000_NAME = 'TURNING'
FRAME_-999000_CLASS = 3
FRAME_-999000_CLASS_ID = -999000
FRAME_-999000_CENTER = -999
CK_-999000_SCLK = -999
CK_-999000_SPK = -999
FRAME_BODY = 1999001
FRAME_1999001_NAME = 'BODY'
FRAME_1999001_CLASS = 2
FRAME_1999001_CLASS_ID = 1999001
FRAME_1999001_CENTER = 1999001
BODY1999001_POLE_RA = ( 0.0 0.0 0.0 )
BODY1999001_POLE_DEC = ( 90.0 0.0 0.0 )
BODY1999001_PM = ( 10.0 36000.0 0.0 )
\begintext
"""
CLOCK = r"""KPL/SCLK
\begindata
SCLK_KERNEL_ID = ( @2015-JUN-01 )
SCLK_DATA_TYPE_999 = ( 1 )
SCLK01_TIME_SYSTEM_999 = ( 2 )
SCLK01_N_FIELDS_999 = ( 2 )
SCLK01_MODULI_999 = ( 4294967296 1000 )
SCLK01_OFFSETS_999 = ( 0 0 )
SCLK01_OUTPUT_DELIM_999 = ( 1 )
SCLK_PARTITION_START_999 = ( 0.0 )
SCLK_PARTITION_END_999 = ( 4294967296000.0 )
SCLK01_COEFFICIENTS_999 = ( 0.0 0.0 1.0 )
\begintext
"""


@pytest.fixture
def kernels(tmp_path):
    """A meta kernel of text kernels, and of a CK that turns evenly and an SPK on a straight line, for 200 s."""
    (tmp_path / "leap.tls").write_text(LSK)
    (tmp_path / "frames.tf").write_text(FRAMES)
    (tmp_path / "clock.tsc").write_text(CLOCK)
    spiceypy.furnsh([str(tmp_path / name) for name in ("leap.tls", "clock.tsc")])
    try:
        # Barycentric and terrestrial time differ by less than 2 ms, the leap second is counted.
        begin = spiceypy.unitim(JULY * 1e-9 - 101, "TT", "ET")
        ticks = [spiceypy.sce2c(-999, begin + s) for s in (0.0, 100.0, 200.0)]
        quaternions = [[math.cos(0.5 * CK_RATE * s), 0.0, 0.0, -math.sin(0.5 * CK_RATE * s)] for s in (0.0, 100.0, 200.0)]
        ck = spiceypy.ckopn(str(tmp_path / "turning.bc"), "turning", 0)
        # A C-matrix leads from the reference frame to that of the spacecraft, which has turned by a positive angle about z.
        rates = [[0.0, 0.0, CK_RATE]] * 3
        spiceypy.ckw03(
            ck, ticks[0], ticks[-1], -999000, "ECLIPJ2000", True, "turning", 3, ticks, quaternions, rates, 1, [ticks[0]]
        )
        spiceypy.ckcls(ck)
        spk = spiceypy.spkopn(str(tmp_path / "line.bsp"), "line", 0)
        states = [[1e6 + 10.0 * s, 2e6 - 20.0 * s, 3e6, 10.0, -20.0, 0.0] for s in (0.0, 100.0, 200.0)]
        spiceypy.spkw08(spk, -999, 10, "ECLIPJ2000", begin, begin + 200, "line", 1, 3, states, begin, 100.0)
        spiceypy.spkcls(spk)
    finally:
        spiceypy.kclear()
    names = ["leap.tls", "frames.tf", "clock.tsc", "turning.bc", "line.bsp"]
    listed = " ".join(f"'$HERE/{name}'" for name in names)
    meta = tmp_path / "all.tm"
    paths = f"PATH_VALUES = ( '{tmp_path}' )\nPATH_SYMBOLS = ( 'HERE' )\n"
    meta.write_text(f"KPL/MK\n\\begindata\n{paths}KERNELS_TO_LOAD = ( {listed} )\n\\begintext\n")
    return meta, names


def run(*arguments):
    return subprocess.run([sys.executable, TOOL, *map(str, arguments)], capture_output=True, text=True)


def made(out, *arguments):
    done = run(*arguments, "-o", out)
    assert done.returncode == 0, done.stderr
    table = pq.read_table(out)
    says = {k.decode(): v.decode() for k, v in table.schema.metadata.items()}
    return table, says, np.stack([table[f"q{i}"].to_numpy() for i in range(4)], axis=1)


def rotated(q, v):
    """q v conjugate(q), written out."""
    w, u = q[0], q[1:]
    return v + 2 * np.cross(u, np.cross(u, v) + w * v)


def test_the_frame_of_a_constant_quaternion(kernels, tmp_path):
    meta, names = kernels
    time = ("--from", "2015-06-30T23:59:50", "--to", "2015-07-01T00:00:10")
    table, says, q = made(tmp_path / "fixed.parquet", meta, "--sc-frame", "FIXED", "--frame", "ECLIPJ2000", *time)
    # A TK frame states the rotation from itself to the frame that it is relative to.
    np.testing.assert_allclose(q, [[0.5, -0.5, 0.5, 0.5]] * 3, atol=1e-15)
    # Ten seconds of SI time: the leap second takes one of them.
    assert table["time_tt2000"].to_pylist() == [JULY - 11 * 10**9, JULY - 10**9, JULY + 9 * 10**9]
    assert [str(t) for t in table["time_utc"].to_numpy()] == [
        "2015-06-30T23:59:50.000000000",
        "2015-06-30T23:59:59.999999999",
        "2015-07-01T00:00:09.000000000",
    ]
    assert (says["attitude_order"], says["attitude_from_to"]) == ("scalar-first", "sc to celestial")
    assert (says["sc_frame"], says["frame"]) == ("FIXED", "ECLIPJ2000")
    stated = json.loads(says["kernels"])
    assert [k["name"] for k in stated] == [meta.name, *names]
    assert all(k["sha256"] == sha256((tmp_path / k["name"]).read_bytes()).hexdigest() for k in stated)


def test_a_body_that_turns_evenly(kernels, tmp_path):
    meta, _ = kernels
    time = ("--from", "2015-07-01T00:00:00", "--to", "2015-07-01T01:00:00", "--step", "60")
    table, _, q = made(tmp_path / "body.parquet", meta, "--sc-frame", "BODY", "--frame", "J2000", *time)
    tt_s = table["time_tt2000"].to_numpy() * 1e-9
    # Periodic terms between barycentric and terrestrial time, as the leap second kernel states them.
    anomaly = 6.239996 + 1.99096871e-7 * tt_s
    tdb_s = tt_s + 1.657e-3 * np.sin(anomaly + 1.671e-2 * np.sin(anomaly))
    # Pole at right ascension 0, declination 90: the node lies at right ascension 90 degrees.
    angle = np.radians(90 + 10 + BODY_DEG_PER_DAY * tdb_s / 86_400)
    for row, a in zip(q, angle, strict=True):
        for v in np.eye(3):
            wanted = [math.cos(a) * v[0] - math.sin(a) * v[1], math.sin(a) * v[0] + math.cos(a) * v[1], v[2]]
            # A microsecond is 7e-9 rad; numbers of seconds in double precision have 0.1 us.
            np.testing.assert_allclose(rotated(row, v), wanted, atol=2e-9)
    # The shorter way from row to row.
    assert (np.sum(q[1:] * q[:-1], axis=1) > 0).all()


def test_a_spacecraft_that_turns_and_moves(kernels, tmp_path):
    meta, _ = kernels
    position = tmp_path / "position.parquet"
    table, says, q = made(
        tmp_path / "turning.parquet",
        *(meta, "--sc-frame", "TURNING", "--frame", "J2000", "--from", "2015-06-30T23:58:10", "--to", "2015-07-01T00:01:50"),
        *("--position", position, "--target", -999, "--observer", 10, "--position-step", 20),
    )
    since_s = (table["time_tt2000"].to_numpy() - (JULY - 101 * 10**9)) * 1e-9
    # Nothing before and behind the 200 s of the kernel.
    assert 0 < len(since_s) <= 21 and since_s.min() > -1e-3 and since_s.max() < 200.001
    c, s = math.cos(OBLIQUITY), math.sin(OBLIQUITY)
    from_ecliptic = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    for row, t in zip(q, since_s, strict=True):
        a = CK_RATE * t
        turned = np.array([[math.cos(a), -math.sin(a), 0], [math.sin(a), math.cos(a), 0], [0, 0, 1]])
        for v in np.eye(3):
            np.testing.assert_allclose(rotated(row, v), from_ecliptic @ turned @ v, atol=1e-9)
    places = pq.read_table(position)
    since_s = (places["time_tt2000"].to_numpy() - (JULY - 101 * 10**9)) * 1e-9
    wanted = from_ecliptic @ np.array([1e6 + 10 * since_s, 2e6 - 20 * since_s, 3e6 + 0 * since_s])
    found = [places[f"{axis}_km"].to_numpy() for axis in "xyz"]
    np.testing.assert_allclose(found, wanted, atol=1e-4)


def test_equal_kernels_give_equal_bytes(kernels, tmp_path):
    meta, _ = kernels
    arguments = (meta, "--sc-frame", "FIXED", "--frame", "J2000", "--from", "2015-07-01", "--to", "2015-07-01T00:10:00")
    for name in ("a.parquet", "b.parquet"):
        made(tmp_path / name, *arguments)
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()


def test_what_cannot_be_made_leaves_no_file(kernels, tmp_path):
    meta, _ = kernels
    out = tmp_path / "none.parquet"
    time = ("--from", "2014-01-01", "--to", "2014-01-01T00:01:00")
    done = run(meta, "--sc-frame", "TURNING", "--frame", "J2000", *time, "-o", out)
    assert (done.returncode, out.exists()) == (1, False) and "no data" in done.stdout
    done = run(meta, "--sc-frame", "NO_SUCH_FRAME", "--frame", "J2000", *time, "-o", out)
    assert (done.returncode, out.exists()) == (2, False) and "NO_SUCH_FRAME" in done.stderr
    done = run(tmp_path / "absent.tm", "--sc-frame", "FIXED", "--frame", "J2000", *time, "-o", out)
    assert (done.returncode, out.exists()) == (2, False) and "absent.tm" in done.stderr
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".calfit-")]
