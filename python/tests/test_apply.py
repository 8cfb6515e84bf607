"""The field comes back from what a file says, for every kind that is applied."""

import json
import math

import calfit
import make
import numpy as np
import pytest
from calfit.steps import FRAMES

FIELDS = [(10_000.0, 0.0, 0.0), (0.0, 10_000.0, 0.0), (0.0, 0.0, 10_000.0), (-3000.0, 9000.0, 3162.0), (0.0, 0.0, 0.0)]
TEMPERATURES = [-40.0, -12.5, 0.0, 20.0, 80.0]


def applied(parameters, readings, t=None, **options):
    readings = np.asarray(readings)
    return parameters.apply(readings[:, 0], readings[:, 1], readings[:, 2], t, **options)


def test_a_run_gives_the_field_in_the_sensor_frame_and_in_coil_axes(tmp_path):
    p = calfit.read(make.put(tmp_path, "A.CPF", make.cpf()))
    readings = [make.reading(f) for f in FIELDS]
    b, _, flags = applied(p, readings)
    np.testing.assert_allclose(b, FIELDS, rtol=0, atol=1e-9)
    assert flags.dtype == np.uint32 and not flags.any()
    coil, _, _ = applied(p, readings, frame="coil")
    # A field along the nominal Z axis of the sensor, turned by rho, then R_nom: nominal Z_m looks along X_c.
    wanted = [make.R_NOM @ make.RHO @ np.array(f) for f in FIELDS]
    np.testing.assert_allclose(coil, wanted, rtol=0, atol=1e-9)
    assert coil[2][0] > 9990.0
    assert p.offset == "b_or" and any("b_or" in note for note in p.notes)


def test_angles_of_the_rosetta_convention_are_those_between_the_directions_that_show_on_one_component(tmp_path):
    xi = (90.4, 89.5, 90.2)
    cpf = make.cpf()
    for path, value in (
        ("matrix.omega_convention", "Rosetta"),
        ("matrix.omega", None),
        ("matrix.phi", None),
        ("matrix.phi_tilde", None),
        ("angle_deg", dict(zip(("xi_xy", "xi_xz", "xi_yz"), xi))),
        ("apply", make.apply("rosetta")),
    ):
        cpf = make.changed(cpf, path, value)
    p = calfit.read(make.put(tmp_path, "A.CPF", cpf))
    raw = np.array([100.0, -2000.0, 30_000.0])
    directions = make.axes(xi)
    wanted = sum(directions[i] * make.SIGMA[i] * (raw[i] - make.OFFSET_ENT[i]) for i in range(3))
    b, _, _ = p.apply(*raw)
    np.testing.assert_allclose(b, wanted, rtol=1e-13)


@pytest.mark.parametrize("offset", ["own", "TOF", "OPF"])
def test_polynomials_give_the_field_at_every_temperature(tmp_path, offset):
    tpf = make.put(tmp_path, "A.TPF", make.tpf())
    if offset == "TOF":
        p = calfit.read(tpf, make.put(tmp_path, "A.TOF", make.tof()))
    elif offset == "OPF":
        p = calfit.read(tpf, make.put(tmp_path, "A.OPF", make.opf()))
    else:
        p = calfit.read(tpf)
    assert p.offset == ("b_or" if offset == "own" else "b_off")
    for t in TEMPERATURES:
        taken = {
            "own": make.at(make.B_OR, "b_or", t),
            "TOF": make.at(make.B_OFF, "b_off", t),
            "OPF": [2.0, -3.0, 4.0],
        }[offset]
        sensor = make.at(make.LINES, "sigma", t), make.at(make.LINES, "xi", t)
        b, _, flags = applied(p, [make.reading(f, *sensor, taken) for f in FIELDS], t)
        np.testing.assert_allclose(b, FIELDS, rtol=0, atol=1e-8)
        assert not flags.any()


def test_polynomials_of_the_offset_without_residual_field_may_stand_in_the_same_file(tmp_path):
    tpf = make.thermal("TPF", make.LINES | make.B_OFF) | {"apply": make.apply(offset="b_off")}
    p = calfit.read(make.put(tmp_path, "A.TPF", tpf))
    t = 20.0
    raw = make.reading(FIELDS[3], make.at(make.LINES, "sigma", t), make.at(make.LINES, "xi", t), make.at(make.B_OFF, "b_off", t))
    np.testing.assert_allclose(p.apply(*raw, t)[0], FIELDS[3], atol=1e-8)
    assert p.offset == "b_off" and not any("b_or" in note for note in p.notes)


@pytest.mark.parametrize("own", [True, False])
def test_polynomials_at_the_centre(tmp_path, own):
    tcf = make.tcf()
    if own:
        p = calfit.read(make.put(tmp_path, "A.TCF", tcf))
    else:
        for name in make.B_OFF:
            tcf = make.changed(tcf, name, None)
        tcf["apply"] = make.apply("rosetta", None)
        p = calfit.read(make.put(tmp_path, "A.TCF", tcf), make.put(tmp_path, "A.TOF", make.tof()))
    raw = np.array([100.0, -2000.0, 30_000.0])
    for t in TEMPERATURES:
        sigma, offset = make.at(make.LINES, "sigma", t), make.at(make.B_OFF, "b_off", t)
        directions = make.axes(make.at(make.LINES, "xi", t))
        wanted = sum(directions[i] * sigma[i] * (raw[i] - offset[i]) for i in range(3))
        np.testing.assert_allclose(p.apply(*raw, t)[0], wanted, rtol=1e-12)


@pytest.mark.parametrize("stated", [True, False])
def test_a_ground_calibration_file(tmp_path, stated):
    # The file of another program may have no table [apply]; it states the same in its keys.
    ground = make.rpcmag() if stated else make.changed(make.rpcmag(), "apply", None)
    p = calfit.read(make.put(tmp_path, "A.TXT", ground))
    raw = np.array([100.0, -2000.0, 30_000.0])
    for t in TEMPERATURES:
        line = lambda a, b: [c + s * t for c, s in zip(ground[a], ground[b])]  # noqa: E731
        xi, sigma = line("XI_10", "XI_11"), line("SIGMA_00", "SIGMA_01")
        offset = [a - r for a, r in zip(line("A_0", "A_1"), ground["B_RES"])]
        m = [sigma[i] * (raw[i] - offset[i]) for i in range(3)]
        k = [sum(ground[f"K_{row}"][i] * m[i] for i in range(3)) for row in range(3)]
        wanted = sum(make.axes(xi)[i] * k[i] for i in range(3))
        np.testing.assert_allclose(p.apply(*raw, t)[0], wanted, rtol=1e-12)


@pytest.mark.parametrize(("kind", "stated"), [("cpf", True), ("cpf", False), ("tpf", True), ("tpf", False), ("tcf", True)])
def test_readings_are_linearised_first_where_the_file_says_so(tmp_path, kind, stated):
    document = make.linearised(getattr(make, kind)())
    if not stated:
        document = make.changed(document, "apply", None)
    p = calfit.read(make.put(tmp_path, "A.toml", document))
    raw = np.array([10_000.0, -20_000.0, 30_000.0])
    linear = raw + np.array(make.C2_PER_ENT) * raw**2 + np.array(make.C3_PER_ENT2) * raw**3
    plain = calfit.read(make.put(tmp_path, "B.toml", getattr(make, kind)()))
    for found, wanted in zip(p.apply(*raw, 20.0), plain.apply(*linear, 20.0)):
        np.testing.assert_allclose(found, wanted, rtol=1e-14)
    assert abs(p.apply(*raw, 20.0)[0] - plain.apply(*raw, 20.0)[0]).max() > 0.5
    assert p.values["linearisation.applied.c2_per_ent"].tolist() == list(make.C2_PER_ENT)


def test_a_stated_rotation_takes_the_field_to_the_reference(tmp_path):
    p = calfit.read(make.put(tmp_path, "A.TPF", make.tpf()))
    about_z = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    b, u, _ = p.apply(100.0, -2000.0, 30_000.0, 20.0)
    turned, u_turned, _ = p.apply(100.0, -2000.0, 30_000.0, 20.0, frame="reference", rotation=about_z)
    np.testing.assert_allclose(turned, [-b[1], b[0], b[2]], rtol=1e-15)
    np.testing.assert_allclose(u_turned, [u[1], u[0], u[2]], rtol=1e-12)
    # An uncertain turn about z moves what lies along x and y.
    _, wider, _ = p.apply(100.0, -2000.0, 30_000.0, 20.0, frame="reference", rotation=about_z, rotation_std_deg=[0.0, 0.0, 0.1])
    small = math.radians(0.1)
    wanted = [math.hypot(u[1], small * b[0]), math.hypot(u[0], small * b[1]), u[2]]
    np.testing.assert_allclose(wider, wanted, rtol=1e-10)


@pytest.mark.parametrize("kind", ["cpf", "tpf", "tcf", "rpcmag"])
def test_a_file_may_state_the_rotation_to_the_reference(tmp_path, kind):
    plain = calfit.read(make.put(tmp_path, "A.toml", getattr(make, kind)()))
    # The limits are those of the sensor axes whatever the frame of the result is.
    document = getattr(make, kind)() | {"valid_field_nt": [[-1e4, 1e4], [-1e4, 1e4], [-1e4, 2e4]]}
    frame = FRAMES["rosetta" if kind in ("tcf", "rpcmag") else "bepicolombo"]
    document["reference"] = {"rotation": make.RHO, "std_deg": 0.1, "from": frame}
    p = calfit.read(make.put(tmp_path, "B.toml", document))
    raw = (100.0, -2000.0, 30_000.0, 20.0)
    given = {"rotation": make.RHO, "rotation_std_deg": 0.1}
    wanted, u, _ = plain.apply(*raw, frame="reference", **given)
    b, uncertainty, flags = p.apply(*raw, frame="reference")
    np.testing.assert_array_equal(b, wanted)
    np.testing.assert_array_equal(uncertainty, u)
    np.testing.assert_allclose(b, make.RHO @ plain.apply(*raw)[0], rtol=1e-14)
    assert flags == (0 if kind == "cpf" else 65536)
    np.testing.assert_array_equal(p.apply(*raw)[0], plain.apply(*raw)[0])
    with pytest.raises(calfit.Refused, match="`rotation` is given, and the file states one"):
        p.apply(*raw, frame="reference", **given)
    for key, value, rule in (
        ("rotation", np.diag([1.0, 1.0, -1.0]), "is no rotation"),
        ("rotation", np.eye(3) * 1.001, "is no rotation"),
        ("std_deg", None, "is missing"),
        ("std_deg", -0.1, "must not be negative"),
        ("from", "sensor (other)", "not the frame of the file"),
    ):
        bad = make.put(tmp_path, "C.toml", make.changed(document, f"reference.{key}", value))
        with pytest.raises(calfit.Refused, match=rf"`reference\.{key}` .*{rule}"):
            calfit.read(bad)


def test_json_twins_and_files_without_a_table_say_the_same(tmp_path):
    raw = (100.0, -2000.0, 30_000.0)
    for name, document, t in (("A.CPF", make.cpf(), None), ("A.TPF", make.tpf(), 20.0)):
        wanted = calfit.read(make.put(tmp_path, name, document)).apply(*raw, t)
        plain = lambda v: v.tolist() if isinstance(v, np.ndarray) else v  # noqa: E731
        twin = tmp_path / f"{name}.json"
        twin.write_text(json.dumps({"written_by": "a test", **document}, default=plain))
        without = make.put(tmp_path, f"old.{name}", make.changed(document, "apply", None))
        for path in (twin, without):
            for found, w in zip(calfit.read(path).apply(*raw, t), wanted):
                np.testing.assert_array_equal(found, w)


def test_null_in_a_twin_is_a_value_that_is_not_determined(tmp_path):
    twin = tmp_path / "A.OPF.json"
    document = make.changed(make.opf(), "offset_ent", [1.0, None, 3.0])
    document["residual_ent"] = [None, 1.0, 2.0]
    twin.write_text(json.dumps(document))
    assert np.isnan(calfit.read(twin).values["offset_ent"][1])
    with pytest.raises(calfit.Refused, match="not determined for y"):
        calfit.read(make.put(tmp_path, "A.TPF", make.tpf()), twin).apply(1.0, 2.0, 3.0, 20.0)


def test_shapes_are_those_of_the_readings(tmp_path):
    p = calfit.read(make.put(tmp_path, "A.TPF", make.tpf()))
    for shape in ((), (1,), (7,), (2, 3), (0,)):
        raw = np.full(shape, 100.0)
        b, u, flags = p.apply(raw, raw, raw, np.full(shape, 20.0))
        assert b.shape == u.shape == (*shape, 3) and flags.shape == shape
    # More than one block, integers, lists.
    many = np.arange(40_000)
    b, u, _ = p.apply(many, many[::-1], -many, 20.0)
    one, u_one, _ = p.apply([39_999], [0], [-39_999], [20])
    np.testing.assert_array_equal(b[-1], one[0])
    np.testing.assert_array_equal(u[-1], u_one[0])
