"""Flags, and what happens outside of what was calibrated."""

import calfit
import make
import numpy as np
import pytest

RAW = (100.0, -2000.0, 3000.0)


def repeated(n):
    return [np.full(n, v) for v in RAW]


def test_the_bits_are_those_of_the_contract():
    assert (calfit.TEMPERATURE, calfit.FIELD, calfit.NO_TEMPERATURE) == (1, 65536, 131072)


def test_temperatures_outside_of_a_file(tmp_path):
    p = calfit.read(make.put(tmp_path, "A.TPF", make.tpf()))
    t = np.array([-40.1, -40.0, 20.0, 80.0, 80.1])
    b, u, flags = p.apply(*repeated(5), t)
    assert flags.tolist() == [1, 0, 0, 0, 1]
    assert np.isfinite(b).all() and np.isfinite(u).all()
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
    _, _, flags = p.apply(*repeated(4), [18.9, 19.0, 21.0, 21.1])
    assert flags.tolist() == [1, 0, 0, 1]
    with pytest.raises(calfit.Refused, match=r"A\.OPF.*conditions\.sensor_degc"):
        p.apply(*RAW, 30.0, outside="error")


def test_a_run_needs_no_temperature(tmp_path):
    p = calfit.read(make.put(tmp_path, "A.CPF", make.cpf()))
    for t in (None, np.nan, 500.0):
        b, u, flags = p.apply(*RAW, t)
        assert np.isfinite(b).all() and np.isfinite(u).all() and flags == 0
    for key, table in (("valid.temperature_degc", [19.5, 20.5]), ("conditions.sensor_degc", [19.5, 20.0, 20.5])):
        p = calfit.read(make.put(tmp_path, "B.CPF", make.changed(make.cpf(), key, table)))
        _, _, flags = p.apply(*repeated(5), [np.nan, 19.4, 19.5, 20.5, 20.6])
        assert flags.tolist() == [0, 1, 0, 0, 1]
        assert p.apply(*RAW)[2] == 0


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
def test_a_reading_that_is_not_finite_gives_no_field_and_no_bit(tmp_path, bad):
    limited = make.changed(make.cpf(), "valid.field_coil_nt", [[-2000.0, 1900.0]] * 3)
    for document, t in ((limited, None), (make.tpf(), 20.0)):
        p = calfit.read(make.put(tmp_path, "A.toml", document))
        for axis in range(3):
            raw = [list(np.full(2, v)) for v in (1.0, 2.0, 3.0)]
            raw[axis][0] = bad
            b, u, flags = p.apply(*raw, t)
            assert np.isnan(b[0]).all() and np.isnan(u[0]).all() and np.isfinite(b[1]).all()
            assert flags.tolist() == [0, 0]


@pytest.mark.parametrize("frame", ["sensor", "coil"])
def test_fields_larger_than_those_that_were_calibrated(tmp_path, frame):
    # The limits are those of the coil axes, and the sensor looks along them in another order: Z_m along X_c.
    cpf = make.changed(make.cpf(), "matrix.rho", np.eye(3))
    cpf["matrix"]["phi"] = make.R_NOM @ np.array(cpf["matrix"]["phi_tilde"])
    cpf["valid"] = {"field_coil_nt": [[-3000.0, 2900.0], [-2000.0, 2000.0], [-500.0, 1000.0]]}
    p = calfit.read(make.put(tmp_path, "A.CPF", cpf))
    cases = [
        ((0.0, 0.0, 2999.0), 0),
        ((0.0, 0.0, 3001.0), 65536),
        ((0.0, 2001.0, 0.0), 65536),
        ((999.0, 0.0, 0.0), 0),
        ((-999.0, 0.0, 0.0), 0),
        ((1001.0, 0.0, 0.0), 65536),
    ]
    for field, wanted in cases:
        b, _, flags = p.apply(*make.reading(field), frame=frame)
        assert flags == wanted, field
        assert np.isfinite(b).all()
