"""Flags, and what happens outside of what was calibrated."""

import calfit
import make
import numpy as np
import pytest

RAW = (100.0, -2000.0, 3000.0)


def repeated(n):
    return [np.full(n, v) for v in RAW]


def test_the_bits_are_those_of_the_contract():
    assert (calfit.TEMPERATURE, calfit.FIELD, calfit.NO_TEMPERATURE, calfit.NO_READING) == (1, 65536, 131072, 262144)


def test_temperatures_outside_of_a_file(tmp_path):
    p = calfit.read(make.put(tmp_path, "A.TPF", make.tpf()))
    t = np.array([-40.1, -40.0, 20.0, 80.0, 80.1])
    b, u, flags = p.apply(*repeated(5), t)
    assert flags.tolist() == [1, 0, 0, 0, 1]
    assert np.isfinite(b).all() and np.isfinite(u[1:4]).all() and np.isnan(u[[0, 4]]).all()
    b0, u0, flags = p.apply(*repeated(5), t, outside="null")
    assert flags.tolist() == [1, 0, 0, 0, 1]
    assert np.isnan(b0[[0, 4]]).all() and np.isnan(u0[[0, 4]]).all()
    np.testing.assert_array_equal(b0[1:4], b[1:4])
    np.testing.assert_array_equal(u0[1:4], u[1:4])
    with pytest.raises(calfit.Refused, match=r"A\.TPF.*`valid_degc` covers -40\.0 to 80\.0 degC; .*index 0 has -40\.1"):
        p.apply(*repeated(5), t, outside="error")
    p.apply(*repeated(3), t[1:4], outside="error")


def test_every_file_has_its_range(tmp_path):
    tof = make.changed(make.tof(), "valid_degc", [0.0, 100.0])
    p = calfit.read(make.put(tmp_path, "A.TPF", make.tpf()), make.put(tmp_path, "A.TOF", tof))
    _, _, flags = p.apply(*repeated(4), [-1.0, 0.0, 80.0, 81.0])
    assert flags.tolist() == [1, 0, 0, 1]
    opf = make.opf() | {"conditions": {"sensor_degc": [19.0, 20.0, 21.0]}}
    p = calfit.read(make.put(tmp_path, "A.TPF", make.tpf()), make.put(tmp_path, "A.OPF", opf))
    _, _, flags = p.apply(*repeated(4), [19.4, 19.5, 20.5, 20.6])
    # The run moved by 2 K: its offset is that at 20 degrees.
    assert flags.tolist() == [1, 0, 0, 1]
    with pytest.raises(calfit.Refused, match=r"A\.OPF.*conditions\.sensor_degc"):
        p.apply(*RAW, 30.0, outside="error")
    opf = make.opf() | {"conditions": {"sensor_degc": [19.6, 20.0, 20.5]}}
    p = calfit.read(make.put(tmp_path, "A.TPF", make.tpf()), make.put(tmp_path, "B.OPF", opf))
    assert p.apply(*repeated(4), [19.5, 19.6, 20.5, 20.6])[2].tolist() == [1, 0, 0, 1]


def test_a_run_needs_no_temperature(tmp_path):
    p = calfit.read(make.put(tmp_path, "A.CPF", make.cpf()))
    for t in (None, np.nan, 500.0):
        b, u, flags = p.apply(*RAW, t)
        assert np.isfinite(b).all() and np.isfinite(u).all() and flags == 0
    # But where it says for which temperatures it holds, it is not known whether it does; the field is the same.
    p = calfit.read(make.put(tmp_path, "B.CPF", make.changed(make.cpf(), "valid.temperature_degc", [19.5, 20.5])))
    found, uncertainty, flags = p.apply(*repeated(5), [np.nan, 19.4, 19.5, 20.5, 20.6])
    assert flags.tolist() == [131072, 1, 0, 0, 1]
    np.testing.assert_array_equal(found, [b] * 5)
    none = [np.nan] * 3
    np.testing.assert_array_equal(uncertainty, [u, none, u, u, none])
    assert p.apply(*RAW)[2] == 131072
    for outside, nan in (("flag", False), ("null", True)):
        assert np.isnan(p.apply(*RAW, outside=outside)[0]).all() == nan
    with pytest.raises(calfit.Refused, match="`t_degc` is not known for the reading at index 0"):
        p.apply(*RAW, outside="error")


@pytest.mark.parametrize("kind", ["tpf", "tcf", "rpcmag"])
def test_polynomials_need_one(tmp_path, kind):
    p = calfit.read(make.put(tmp_path, "A.toml", getattr(make, kind)()))
    b, u, flags = p.apply(*repeated(4), [20.0, np.nan, np.inf, 20.0])
    assert flags.tolist() == [0, 131072, 131072, 0]
    assert np.isnan(b[1:3]).all() and np.isnan(u[1:3]).all() and np.isfinite(b[[0, 3]]).all()
    with pytest.raises(calfit.Refused, match="`t_degc` is missing"):
        p.apply(*RAW)
    # A masked temperature is none.
    _, _, flags = p.apply(*repeated(2), np.ma.masked_array([20.0, 20.0], [False, True]))
    assert flags.tolist() == [0, 131072]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_reading_that_is_not_finite_gives_no_field_and_says_so(tmp_path, bad):
    limited = make.changed(make.cpf(), "valid.field_coil_nt", [[-2000.0, 1900.0]] * 3)
    for document, t in ((limited, None), (make.tpf(), 20.0), (make.linearised(make.cpf()), None)):
        p = calfit.read(make.put(tmp_path, "A.toml", document))
        for axis in range(3):
            raw = [list(np.full(2, v)) for v in (1.0, 2.0, 3.0)]
            raw[axis][0] = bad
            b, u, flags = p.apply(*raw, t)
            assert np.isnan(b[0]).all() and np.isnan(u[0]).all() and np.isfinite(b[1]).all()
            assert flags.tolist() == [262144, 0]
            with pytest.raises(calfit.Refused, match="at index 0"):
                p.apply(*raw, t, outside="error")


@pytest.mark.parametrize("frame", ["sensor", "coil"])
def test_fields_outside_of_those_that_were_calibrated(tmp_path, frame):
    # The limits are those of the coil axes, and the sensor looks along them in another order: Z_m along X_c, X_m against Z_c.
    cpf = make.changed(make.cpf(), "matrix.rho", np.eye(3))
    cpf["matrix"]["phi"] = make.R_NOM @ np.array(cpf["matrix"]["phi_tilde"])
    cpf["valid"] = {"field_coil_nt": [[-3000.0, 2900.0], [-2000.0, 2000.0], [-500.0, 1000.0]]}
    p = calfit.read(make.put(tmp_path, "A.CPF", cpf))
    cases = [
        ((0.0, 0.0, 2899.0), 0),
        ((0.0, 0.0, 2901.0), 65536),
        ((0.0, 0.0, -2999.0), 0),
        ((0.0, 2001.0, 0.0), 65536),
        ((499.0, 0.0, 0.0), 0),
        ((501.0, 0.0, 0.0), 65536),
        ((-999.0, 0.0, 0.0), 0),
        ((-1001.0, 0.0, 0.0), 65536),
    ]
    for field, wanted in cases:
        b, _, flags = p.apply(*make.reading(field), frame=frame)
        assert flags == wanted, field
        assert np.isfinite(b).all()


@pytest.mark.parametrize("kind", ["tpf", "tcf", "rpcmag"])
def test_limits_along_the_axes_of_the_sensor(tmp_path, kind):
    plain = calfit.read(make.put(tmp_path, "A.toml", getattr(make, kind)()))
    limits = [[-3000.0, 2900.0], [-2000.0, 2500.0], [500.0, 1000.0]]
    path = make.put(tmp_path, "B.toml", getattr(make, kind)() | {"valid_field_nt": limits})
    p = calfit.read(path)
    # Lines of readings across the limits, whatever the matrix is.
    readings = np.linspace(-4000.0, 4000.0, 801)[:, None] * np.array([1.0, 0.9, 0.1]) + np.array([0.0, 0.0, 700.0])
    b, u, _ = plain.apply(*readings.T, 20.0)
    found, uncertainty, flags = p.apply(*readings.T, 20.0)
    np.testing.assert_array_equal(found, b)
    np.testing.assert_array_equal(uncertainty, u)
    outside = np.array([any(not low <= c <= high for c, (low, high) in zip(field, limits)) for field in b])
    assert 50 < outside.sum() < 750
    np.testing.assert_array_equal(flags, np.where(outside, 65536, 0))
    found, uncertainty, flags = p.apply(*readings.T, 20.0, outside="null")
    np.testing.assert_array_equal(np.isnan(found).any(axis=1), outside)
    np.testing.assert_array_equal(np.isnan(uncertainty).all(axis=1), outside)
    np.testing.assert_array_equal(flags != 0, outside)
    rule = "`valid_field_nt` covers x -3000.0 to 2900.0, y -2000.0 to 2500.0, z 500.0 to 1000.0 nT; the field of the reading at index 0 "
    with pytest.raises(calfit.Refused, match=rule):
        p.apply(*readings.T, 20.0, outside="error")
    p.apply(*readings[~outside].T, 20.0, outside="error")
    # Where there is no temperature there is no field, and nothing is said of it.
    assert p.apply(*readings.T, np.full(801, np.nan))[2].tolist() == [131072] * 801
    # A limit that is not determined holds nothing.
    limits[1][0] = float("nan")
    p = calfit.read(make.put(tmp_path, "C.toml", getattr(make, kind)() | {"valid_field_nt": limits}))
    assert p.apply(*readings.T, 20.0)[2].tolist() == [65536] * 801


@pytest.mark.parametrize("kind", ["cpf", "tpf", "tcf"])
def test_readings_outside_of_those_that_were_linearised(tmp_path, kind):
    document = make.linearised(getattr(make, kind)(), [[-100.0, 200.0], [-300.0, 400.0], [-500.0, 600.0]])
    p = calfit.read(make.put(tmp_path, "A.toml", document))
    for raw, wanted in (
        ((-100.0, 400.0, 600.0), 0),
        ((-100.1, 0.0, 0.0), 65536),
        ((200.1, 0.0, 0.0), 65536),
        ((0.0, -300.1, 0.0), 65536),
        ((0.0, 0.0, 600.1), 65536),
    ):
        b, _, flags = p.apply(*raw, 20.0)
        assert flags == wanted and np.isfinite(b).all(), raw
    rule = "`linearisation.applied.reading_ent` covers x -100.0 to 200.0, .* enT; the reading at index 1 is"
    with pytest.raises(calfit.Refused, match=rule):
        p.apply([0.0, 201.0], [0.0, 0.0], [0.0, 0.0], 20.0, outside="error")
