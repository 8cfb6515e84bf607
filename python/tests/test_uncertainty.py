"""Uncertainties have their closed forms; those of the derivatives by a second way, differences of the definition."""

import math

import calfit
import make
import numpy as np
import pytest

RIGHT = (90.0, 90.0, 90.0)
RAW = np.array([1000.0, -20_000.0, 30_000.0])
M = RAW - np.array(make.OFFSET_ENT)
RAD = math.pi / 180.0


def polynomial(covariance, t):
    """Variance of a polynomial at a temperature, written out."""
    n = len(covariance)
    return sum(covariance[i][j] * t ** (i + j) for i in range(n) for j in range(n))


def test_a_run_with_standard_uncertainties_alone(tmp_path):
    # With right angles omega is 1, and its derivatives are those of sines: B_y takes xi_xy times sigma_x m_x, and so on.
    cpf = make.cpf(xi_deg=RIGHT)
    _, u, _ = calfit.read(make.put(tmp_path, "A.CPF", cpf)).apply(*RAW)
    s, std = make.SIGMA, cpf["std"]
    xi = [a * RAD for a in std["xi_deg"]]
    own = [(M[i] * std["sigma"][i]) ** 2 + (s[i] * std["b_or_ent"][i]) ** 2 for i in range(3)]
    x, y = s[0] * M[0], s[1] * M[1]
    wanted = [own[0], own[1] + (x * xi[0]) ** 2, own[2] + (x * xi[1]) ** 2 + (y * xi[2]) ** 2]
    np.testing.assert_allclose(u, np.sqrt(wanted), rtol=1e-12)


def test_the_covariance_of_a_run_in_both_frames(tmp_path):
    # Independent uncertainties of sigma, xi and three turns of the sensor, right angles, no rotation: the covariance of phi follows.
    s, std = np.array(make.SIGMA), {"sigma": [1e-5, 2e-5, 3e-5], "xi": [1e-3 * RAD, 2e-3 * RAD, 3e-3 * RAD], "turn": 4e-4}
    columns = []
    for i in range(3):
        by = np.zeros((3, 3))
        by[i, i] = 1.0
        columns.append(by * std["sigma"][i])
    for (row, column), size in zip(((1, 0), (2, 0), (2, 1)), std["xi"]):
        by = np.zeros((3, 3))
        by[row, column] = s[column]
        columns.append(by * size)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        by = np.zeros((3, 3))
        by[i, j], by[j, i] = -s[j], s[i]
        columns.append(by * std["turn"])
    jacobian = np.array([c.ravel() for c in columns]).T
    matrix = np.zeros((12, 12))
    matrix[:9, :9] = jacobian @ jacobian.T
    matrix[9:, 9:] = np.diag([1e-4, 4e-4, 9e-4])
    names = [f"phi_{r}{c}" for r in "xyz" for c in "xyz"] + ["b_or_x", "b_or_y", "b_or_z"]
    cpf = make.cpf(xi_deg=RIGHT)
    cpf["matrix"] |= {"r_nom": np.eye(3), "rho": np.eye(3), "phi": np.diag(s)}
    # The order of the parameters is that of their names.
    order = list(reversed(range(12)))
    cpf["covariance"] = {"parameters": [names[i] for i in order], "matrix": matrix[np.ix_(order, order)]}
    # Not those of the covariance, so that it shows which of them are taken.
    cpf["std"] = {"sigma": [1.0] * 3, "xi_deg": [1.0] * 3, "b_or_ent": [1.0] * 3}
    p = calfit.read(make.put(tmp_path, "A.CPF", cpf))
    _, u, _ = p.apply(*RAW)
    f = s * M
    own = [(M[i] * std["sigma"][i]) ** 2 + s[i] ** 2 * matrix[9 + i, 9 + i] for i in range(3)]
    xi = std["xi"]
    # The turns are no uncertainty of the field in the sensor frame.
    sensor = [own[0], own[1] + (f[0] * xi[0]) ** 2, own[2] + (f[0] * xi[1]) ** 2 + (f[1] * xi[2]) ** 2]
    np.testing.assert_allclose(u, np.sqrt(sensor), rtol=1e-10)
    _, u, _ = p.apply(*RAW, frame="coil")
    across = [f[1] ** 2 + f[2] ** 2, f[0] ** 2 + f[2] ** 2, f[0] ** 2 + f[1] ** 2]
    coil = [sensor[i] + std["turn"] ** 2 * across[i] for i in range(3)]
    np.testing.assert_allclose(u, np.sqrt(coil), rtol=1e-10)


def split(phi):
    """sigma and xi of Phi as the report splits it (BC-MAG-TR-0085 section 15.1), and omega sigma from them."""
    psi = np.linalg.inv(phi.T)
    sigma = 1.0 / np.linalg.norm(psi, axis=0)
    base = np.linalg.inv((phi / sigma).T)
    angle = lambda i, j: math.degrees(math.acos(base[:, i] @ base[:, j]))  # noqa: E731
    return np.linalg.inv(make.axes((angle(0, 1), angle(0, 2), angle(1, 2)))) * sigma


def test_the_covariance_of_a_run_with_any_angles_and_rotation(tmp_path):
    cpf = make.cpf()
    phi = np.array(cpf["matrix"]["phi"])
    random = np.random.default_rng(1).normal(size=(12, 12)) * np.array([1e-5] * 9 + [0.02] * 3)[:, None]
    matrix = random @ random.T
    names = [f"phi_{r}{c}" for r in "xyz" for c in "xyz"] + ["b_or_x", "b_or_y", "b_or_z"]
    cpf["covariance"] = {"parameters": names, "matrix": matrix}
    p = calfit.read(make.put(tmp_path, "A.CPF", cpf))
    # Central differences of the definition: the angles come from arc cosines, 1e-16 over steps of 1e-6.
    step = 1e-6
    columns = [
        (split(phi + step * by.reshape(3, 3)) @ M - split(phi - step * by.reshape(3, 3)) @ M) / (2.0 * step) for by in np.eye(9)
    ]
    jacobian = np.concatenate([np.array(columns).T, -split(phi)], axis=1)
    wanted = np.sqrt(np.diagonal(jacobian @ matrix @ jacobian.T))
    np.testing.assert_allclose(p.apply(*RAW)[1], wanted, rtol=1e-6)
    # To coil axes Phi itself is the matrix.
    jacobian = np.concatenate([np.kron(np.eye(3), M), -phi], axis=1)
    np.testing.assert_allclose(p.apply(*RAW, frame="coil")[1], np.sqrt(np.diagonal(jacobian @ matrix @ jacobian.T)), rtol=1e-10)


def test_the_same_in_the_rosetta_convention(tmp_path):
    # The columns of omega sigma have the lengths and angles of those of Phi, the first along x, the second in the plane of x and y.
    xi = (90.4, 89.5, 90.2)
    transfer = make.axes(xi).T * np.array(make.SIGMA)
    phi = make.R_NOM @ make.RHO @ transfer
    cpf = make.cpf()
    cpf["apply"] = make.apply("rosetta", extra=("rho", "r_nom"))
    cpf["matrix"] |= {"omega_convention": "Rosetta", "omega": make.axes(xi).T, "phi": phi, "phi_tilde": transfer}
    cpf["angle_deg"] = dict(zip(("xi_xy", "xi_xz", "xi_yz"), xi))
    random = np.random.default_rng(2).normal(size=(12, 12)) * np.array([1e-5] * 9 + [0.02] * 3)[:, None]
    names = [f"phi_{r}{c}" for r in "xyz" for c in "xyz"] + ["b_or_x", "b_or_y", "b_or_z"]
    cpf["covariance"] = {"parameters": names, "matrix": random @ random.T}

    def field(phi):
        length = np.linalg.norm(phi, axis=0)
        unit = phi / length
        angle = lambda i, j: math.degrees(math.acos(unit[:, i] @ unit[:, j]))  # noqa: E731
        return (make.axes((angle(0, 1), angle(0, 2), angle(1, 2))).T * length) @ M

    step = 1e-6
    columns = [(field(phi + step * by.reshape(3, 3)) - field(phi - step * by.reshape(3, 3))) / (2.0 * step) for by in np.eye(9)]
    jacobian = np.concatenate([np.array(columns).T, -transfer], axis=1)
    wanted = np.sqrt(np.diagonal(jacobian @ random @ random.T @ jacobian.T))
    b, u, _ = calfit.read(make.put(tmp_path, "A.CPF", cpf)).apply(*RAW)
    np.testing.assert_allclose(b, field(phi), rtol=1e-12)
    np.testing.assert_allclose(u, wanted, rtol=1e-6)


def right(lines):
    """The same polynomials with right angles at every temperature, so that closed forms are short."""
    return lines | {"xi_xy": (90.0, 0.0), "xi_xz": (90.0, 0.0), "xi_yz": (90.0, 0.0)}


@pytest.mark.parametrize("offset", ["own", "TOF", "OPF"])
@pytest.mark.parametrize("t", [-30.0, 0.0, 55.0])
def test_polynomials(tmp_path, offset, t):
    lines = right(make.LINES)
    c = make.covariances(lines, 1e-5)
    tpf = make.thermal("TPF", lines | make.B_OR) | {"apply": make.apply()}
    tpf["covariance"] = c | make.covariances(make.B_OR, 0.1)
    path = make.put(tmp_path, "A.TPF", tpf)
    if offset == "own":
        p = calfit.read(path)
        taken = make.at(make.B_OR, "b_or", t)
        variance = [polynomial(tpf["covariance"][f"b_or_{a}"], t) for a in "xyz"]
    elif offset == "TOF":
        tof = make.tof()
        p = calfit.read(path, make.put(tmp_path, "A.TOF", tof))
        taken = make.at(make.B_OFF, "b_off", t)
        variance = [polynomial(tof["covariance"][f"b_off_{a}"], t) for a in "xyz"]
    else:
        p = calfit.read(path, make.put(tmp_path, "A.OPF", make.opf()))
        taken, variance = [2.0, -3.0, 4.0], [0.01, 0.04, 0.09]
    m, s = RAW - np.array(taken), make.at(lines, "sigma", t)
    own = [m[i] ** 2 * polynomial(c[f"sigma_{a}"], t) + s[i] ** 2 * variance[i] for i, a in enumerate("xyz")]
    xi = {pair: polynomial(c[f"xi_{pair}"], t) * RAD**2 for pair in ("xy", "xz", "yz")}
    x, y = (s[0] * m[0]) ** 2, (s[1] * m[1]) ** 2
    wanted = [own[0], own[1] + x * xi["xy"], own[2] + x * xi["xz"] + y * xi["yz"]]
    np.testing.assert_allclose(p.apply(*RAW, t)[1], np.sqrt(wanted), rtol=1e-12)


@pytest.mark.parametrize("t", [-30.0, 0.0, 55.0])
def test_what_runs_share_moves_all_parameters_at_once(tmp_path, t):
    lines = right(make.LINES) | make.B_OR
    own = make.covariances(right(make.LINES), 1e-5) | make.covariances(make.B_OR, 0.1)
    change = {name: [1e-4 * (k + 1) / 50.0**order for order in range(len(lines[name]))] for k, name in enumerate(lines)}
    change |= {f"xi_{pair}": [0.0, 0.0] for pair in ("xy", "xz", "yz")}
    combined = {name: np.array(own[name]) + np.outer(change[name], change[name]) for name in lines}
    tpf = make.thermal("TPF", lines) | {"apply": make.apply(), "common": [{"source": "a coil"} | change]}
    tpf |= {"covariance": own, "covariance_combined": combined}
    m, s = RAW - np.array(make.at(make.B_OR, "b_or", t)), make.at(lines, "sigma", t)
    moved = [make.at(change, stem, t) for stem in ("sigma", "b_or")]
    xi = {pair: polynomial(own[f"xi_{pair}"], t) * RAD**2 for pair in ("xy", "xz", "yz")}
    x, y = (s[0] * m[0]) ** 2, (s[1] * m[1]) ** 2
    angles = [0.0, x * xi["xy"], x * xi["xz"] + y * xi["yz"]]
    wanted = [
        m[i] ** 2 * polynomial(own[f"sigma_{a}"], t) + s[i] ** 2 * polynomial(own[f"b_or_{a}"], t) + angles[i]
        + (m[i] * moved[0][i] - s[i] * moved[1][i]) ** 2
        for i, a in enumerate("xyz")
    ]
    np.testing.assert_allclose(calfit.read(make.put(tmp_path, "A.TPF", tpf)).apply(*RAW, t)[1], np.sqrt(wanted), rtol=1e-11)


@pytest.mark.parametrize("t", [-30.0, 0.0, 55.0])
def test_a_cube_stated_for_the_other_convention(tmp_path, t):
    # The same sensor has an upper triangular matrix in the frame that the cube is stated for: that of a QR decomposition.
    cube = make.turn([3.0, -20.0, 50.0])
    lines = make.LINES | make.B_OR
    names = [(name, k) for name in lines for k in range(len(lines[name]))]

    def field(coefficients):
        at = {name: sum(coefficients[i] * t**k for i, (own, k) in enumerate(names) if own == name) for name in lines}
        directions = make.axes([at[f"xi_{pair}"] for pair in ("xy", "xz", "yz")])
        matrix = np.linalg.inv(directions) @ np.diag([at[f"sigma_{a}"] for a in "xyz"])
        upper = np.linalg.qr(matrix)[1]
        upper = np.sign(np.diagonal(upper))[:, None] * upper
        return cube @ upper @ (RAW - np.array([at[f"b_or_{a}"] for a in "xyz"]))

    values = np.array([lines[name][k] for name, k in names], dtype=float)
    tpf = make.tpf() | {
        "reference": {
            "rotation": np.eye(3), "std_deg": 0.0, "from": "sensor (BepiColombo): x along sensor axis x, y in the plane of x and y", "stated_for": "rosetta", "stated_rotation": cube
        }
    }
    columns = []
    for i, value in enumerate(values):
        step = 1e-6 * max(abs(value), 1e-2)
        by = np.where(np.arange(len(values)) == i, step, 0.0)
        columns.append((field(values + by) - field(values - by)) / (2.0 * step))
    jacobian, whole = np.array(columns).T, np.zeros((len(values),) * 2)
    for i, (a, j) in enumerate(names):
        for k, (b, l) in enumerate(names):
            whole[i, k] = tpf["covariance"][a][j][l] if a == b else 0.0
    b, u, _ = calfit.read(make.put(tmp_path, "A.TPF", tpf)).apply(*RAW, t, frame="reference")
    np.testing.assert_allclose(b, field(values), rtol=1e-12)
    np.testing.assert_allclose(u, np.sqrt(np.diagonal(jacobian @ whole @ jacobian.T)), rtol=1e-5)


def centre(t, covariance, together=None, remainder=((0.0,) * 3, (0.0,) * 3)):
    """A TCF with right angles, and the derivatives of the field in its convention: B_x takes -xi_xy times sigma_y m_y, and so on."""
    lines = right(make.LINES)
    tcf = make.thermal("TCF", lines | make.B_OFF, version=2) | {"apply": make.apply("rosetta", "b_off"), "covariance": covariance}
    tcf |= {"sigma_remainder": list(remainder[0]), "xi_remainder_deg": list(remainder[1])}
    if together is not None:
        tcf["together"] = together
    m = RAW - np.array(make.at(make.B_OFF, "b_off", t))
    s = make.at(lines, "sigma", t)
    jacobian = np.zeros((3, 9))
    for i in range(3):
        jacobian[i, i], jacobian[i, 6 + i] = m[i], -s[i]
    jacobian[0, 3], jacobian[0, 4], jacobian[1, 5] = -s[1] * m[1] * RAD, -s[2] * m[2] * RAD, -s[2] * m[2] * RAD
    return tcf, jacobian


NAMES = ("sigma_x", "sigma_y", "sigma_z", "xi_xy", "xi_xz", "xi_yz", "b_off_x", "b_off_y", "b_off_z")


@pytest.mark.parametrize("t", [-30.0, 0.0, 55.0])
def test_polynomials_at_the_centre_with_what_they_miss(tmp_path, t):
    covariance = make.covariances(right(make.LINES), 1e-5) | make.covariances(make.B_OFF, 0.2)
    remainder = ((1e-4, 2e-4, 3e-4), (1e-3, 2e-3, 3e-3))
    tcf, jacobian = centre(t, covariance, None, remainder)
    variances = [polynomial(covariance[n], t) for n in NAMES]
    variances = [v + r**2 for v, r in zip(variances, (*remainder[0], *remainder[1], 0.0, 0.0, 0.0))]
    wanted = np.sqrt((jacobian**2) @ variances)
    np.testing.assert_allclose(calfit.read(make.put(tmp_path, "A.TCF", tcf)).apply(*RAW, t)[1], wanted, rtol=1e-12)


@pytest.mark.parametrize("form", ["TCF", "TPF"])
@pytest.mark.parametrize("t", [-30.0, 0.0, 55.0])
def test_a_covariance_of_all_coefficients_is_used_whole(tmp_path, t, form):
    lines = right(make.LINES)
    names = [f"{n}.{k}" for n in NAMES[:6] for k in range(len(lines[n]))]
    # A thousandth of a degree moves the field as much as 2e-5 of a sensitivity.
    size = np.array([(1e-5 if n.startswith("sigma") else 1e-3) / 10.0 ** int(n[-1]) for n in names])
    random = np.random.default_rng(3).normal(size=(len(names), len(names)))
    joint = random @ random.T * np.outer(size, size)
    # A parameter that applying does not need, in the middle.
    wide = np.insert(np.insert(joint, 4, 0.0, axis=0), 4, 0.0, axis=1)
    wide[4, 4] = 7.0
    together = {"parameters": [*names[:4], "k_inverse.0.1", *names[4:]], "units": [""] * (len(names) + 1), "matrix": wide}
    covariance = make.covariances(lines, 1e-5) | make.covariances(make.B_OFF, 0.2)
    document, jacobian = centre(t, covariance, together)
    if form == "TPF":
        # In this convention B_y takes xi_xy times sigma_x m_x, and so on.
        document |= {"format": "TPF", "version": 1, "apply": make.apply(offset="b_off")}
        s_m = np.array(make.at(lines, "sigma", t)) * (RAW - np.array(make.at(make.B_OFF, "b_off", t)))
        jacobian[:, 3:6] = 0.0
        jacobian[1, 3], jacobian[2, 4], jacobian[2, 5] = s_m[0] * RAD, s_m[0] * RAD, s_m[1] * RAD
    by = np.zeros((6, len(names)))
    for column, name in enumerate(names):
        by[NAMES.index(name[:-2]), column] = t ** int(name[-1])
    whole = np.zeros((9, 9))
    whole[:6, :6] = by @ joint @ by.T
    whole[6:, 6:] = np.diag([polynomial(covariance[n], t) for n in NAMES[6:]])
    wanted = np.sqrt(np.diagonal(jacobian @ whole @ jacobian.T))
    found = calfit.read(make.put(tmp_path, "A", document)).apply(*RAW, t)[1]
    np.testing.assert_allclose(found, wanted, rtol=1e-11)
    # Without the cross-covariances it would be another number.
    without = np.sqrt((jacobian**2) @ np.diagonal(whole))
    assert np.abs(found / without - 1.0).max() > 0.01
    # Combined covariances of the polynomials are not replaced by one of type A.
    combined = calfit.read(make.put(tmp_path, "B", document | {"covariance_combined": covariance}))
    variances = [polynomial(covariance[n], t) for n in NAMES]
    np.testing.assert_allclose(combined.apply(*RAW, t)[1], np.sqrt((jacobian**2) @ variances), rtol=1e-12)


def test_the_covariance_of_a_measured_offset_is_used_whole(tmp_path):
    opf = make.opf()
    matrix = np.array([[0.01, 0.018, 0.0, 0.5], [0.018, 0.04, -0.03, 0.5], [0.0, -0.03, 0.09, 0.5], [0.5, 0.5, 0.5, 100.0]])
    names = ["offset_x", "offset_y", "offset_z", "residual_coil_x"]
    opf["covariance"] = {"parameters": names, "units": ["enT", "enT", "enT", "nT"], "matrix": matrix}
    # Certain sensitivities and angles, so that the offset alone is uncertain.
    tpf = make.tpf()
    tpf["covariance"] = {n: [[0.0 * v for v in row] for row in rows] for n, rows in tpf["covariance"].items()}
    p = calfit.read(make.put(tmp_path, "A.TPF", tpf), make.put(tmp_path, "A.OPF", opf))
    t = 20.0
    transfer = np.linalg.inv(make.axes(make.at(make.LINES, "xi", t))) * make.at(make.LINES, "sigma", t)
    _, u, _ = p.apply(*RAW, t)
    np.testing.assert_allclose(u, np.sqrt(np.diagonal(transfer @ matrix[:3, :3] @ transfer.T)), rtol=1e-12)


@pytest.mark.parametrize("t", [-30.0, 0.0, 55.0])
def test_a_ground_calibration_file(tmp_path, t):
    ground = make.rpcmag()
    labels = ("A_0", "A_1", "B_RES", "SIGMA_00", "SIGMA_01", "XI_10", "XI_11", "K_0", "K_1", "K_2")

    def field(changed):
        line = lambda a, b: [c + s * t for c, s in zip(changed[a], changed[b])]  # noqa: E731
        offset = np.array(line("A_0", "A_1")) - np.array(changed["B_RES"])
        k_inverse = np.array([changed["K_0"], changed["K_1"], changed["K_2"]])
        return make.axes(line("XI_10", "XI_11")).T @ k_inverse @ (np.array(line("SIGMA_00", "SIGMA_01")) * (RAW - offset))

    variance = np.zeros(3)
    for label in labels:
        for i in range(3):
            # Nearly linear within the uncertainty, so that central differences of that size are exact to their square.
            up, down = (
                {**ground, label: [v + sign * ground["std"][label][i] * (j == i) for j, v in enumerate(ground[label])]}
                for sign in (1.0, -1.0)
            )
            variance += ((field(up) - field(down)) / 2.0) ** 2
    p = calfit.read(make.put(tmp_path, "A.TXT", ground))
    np.testing.assert_allclose(p.apply(*RAW, t)[1], np.sqrt(variance), rtol=1e-7)


@pytest.mark.parametrize("t", [-30.0, 0.0, 55.0])
def test_the_covariance_of_a_ground_calibration_file_is_used_whole(tmp_path, t):
    ground = make.rpcmag()
    labels = {"A_0": "xyz", "A_1": "xyz", "B_RES": "xyz", "SIGMA_00": "xyz", "SIGMA_01": "xyz"}
    labels |= {label: ("xy", "xz", "yz") for label in ("XI_10", "XI_11")} | {"K_0": "xyz", "K_1": "yz", "K_2": "z"}
    names = [f"{label}_{component}" for label, components in labels.items() for component in components]
    size = {name: ground["std"][name.rpartition("_")[0]][place(name)] or 1e-6 for name in names}
    rng = np.random.default_rng(4)
    # What has no row is exact: a slope that was not fitted.
    names = [names[i] for i in rng.permutation(len(names)) if names[i] not in ("SIGMA_01_y", "XI_11_xz", "K_2_z")]
    root = rng.normal(size=(len(names), len(names))) * np.array([[size[name]] for name in names]) / math.sqrt(len(names))
    matrix = root @ root.T

    def field(change):
        changed = {label: list(ground[label]) for label in labels}
        for name, by in change.items():
            changed[name.rpartition("_")[0]][place(name)] += by
        line = lambda a, b: np.array(changed[a]) + np.array(changed[b]) * t  # noqa: E731
        offset = line("A_0", "A_1") - np.array(changed["B_RES"])
        k_inverse = np.array([changed["K_0"], changed["K_1"], changed["K_2"]])
        return make.axes(line("XI_10", "XI_11")).T @ k_inverse @ (line("SIGMA_00", "SIGMA_01") * (RAW - offset))

    jacobian = np.array([(field({n: size[n]}) - field({n: -size[n]})) / (2.0 * size[n]) for n in names]).T
    wanted = np.sqrt(np.diagonal(jacobian @ matrix @ jacobian.T))
    stated = ground | {"covariance": {"parameters": names, "units": [""] * len(names), "matrix": matrix}}
    p = calfit.read(make.put(tmp_path, "A.TXT", stated))
    b, u, _ = p.apply(*RAW, t)
    np.testing.assert_allclose(b, field({}), rtol=1e-12)
    np.testing.assert_allclose(u, wanted, rtol=1e-6)
    # Not the standard uncertainties, which may then be left out; and the correlations count.
    without = calfit.read(make.put(tmp_path, "B.TXT", make.changed(stated, "std", None)))
    np.testing.assert_array_equal(without.apply(*RAW, t)[1], u)
    assert not any("no uncertainty" in note for note in without.notes)
    assert np.abs(np.sqrt((jacobian**2) @ np.diagonal(matrix)) / u - 1.0).max() > 0.01
    assert p.covariance["covariance"].parameters == tuple(names)


def place(name):
    """The place of a component in its list."""
    return {"x": 0, "y": 1, "z": 2, "xy": 0, "xz": 1, "yz": 2}[name.rpartition("_")[2]]


def test_residual_field_and_offset_of_one_measurement_cancel(tmp_path):
    # B_RES = A_0 - B_off: with B_off exact both have one error, and it is not in the field.
    ground = make.rpcmag()
    names = ["A_0_x", "B_RES_x"]
    ground["covariance"] = {"parameters": names, "matrix": [[0.04, 0.04], [0.04, 0.04]]}
    np.testing.assert_array_equal(calfit.read(make.put(tmp_path, "A.TXT", ground)).apply(*RAW, 5.0)[1], [0.0] * 3)


def test_without_a_transfer_and_a_residual_field_nothing_is_uncertain_of_them(tmp_path):
    ground = make.rpcmag() | {"B_RES": [0.0] * 3, "K_0": [1.0, 0.0, 0.0], "K_1": [0.0, 1.0, 0.0], "K_2": [0.0, 0.0, 1.0]}
    zero = {label: [0.0] * 3 for label in ("K_0", "K_1", "K_2", "B_RES")}
    stated = calfit.read(make.put(tmp_path, "A.TXT", ground | {"std": ground["std"] | zero}))
    std = {k: v for k, v in ground["std"].items() if not k.startswith("K_") and k != "B_RES"}
    left_out = calfit.read(make.put(tmp_path, "B.TXT", ground | {"std": std}))
    np.testing.assert_array_equal(left_out.apply(*RAW, 5.0)[1], stated.apply(*RAW, 5.0)[1])
    # But where there is a transfer, its uncertainty has to be stated.
    ground["K_0"] = [1.0, 1e-4, 0.0]
    unknown = calfit.read(make.put(tmp_path, "C.TXT", ground | {"std": std}))
    b, u, _ = unknown.apply(*RAW, 5.0)
    assert np.isfinite(b).all() and np.isnan(u).all()
    assert any("std.K_0" in note for note in unknown.notes)


def test_combined_uncertainties_stand_in_place_of_those_of_type_a(tmp_path):
    cpf = make.cpf(xi_deg=RIGHT)
    wide = {k: [10.0 * v for v in std] for k, std in cpf["std"].items()}
    narrow = calfit.read(make.put(tmp_path, "A.CPF", cpf))
    # A covariance of type A does not stand for combined standard uncertainties.
    names = [f"phi_{r}{c}" for r in "xyz" for c in "xyz"] + ["b_or_x", "b_or_y", "b_or_z"]
    both = cpf | {"std_combined": wide, "covariance": {"parameters": names, "matrix": np.eye(12) * 1e-20}}
    combined = calfit.read(make.put(tmp_path, "B.CPF", both))
    np.testing.assert_allclose(combined.apply(*RAW)[1], 10.0 * narrow.apply(*RAW)[1], rtol=1e-12)
    np.testing.assert_array_equal(combined.std["offset.b_or_ent"], wide["b_or_ent"])
    tpf = make.tpf()
    more = {k: [[100.0 * v for v in row] for row in rows] for k, rows in tpf["covariance"].items()}
    narrow = calfit.read(make.put(tmp_path, "A.TPF", tpf))
    combined = calfit.read(make.put(tmp_path, "B.TPF", tpf | {"covariance_combined": more}))
    np.testing.assert_allclose(combined.apply(*RAW, 5.0)[1], 10.0 * narrow.apply(*RAW, 5.0)[1], rtol=1e-12)
    np.testing.assert_array_equal(combined.covariance["xi_xy"].matrix, more["xi_xy"])


@pytest.mark.parametrize("missing", ["covariance.xi_yz", "covariance.b_or_x"])
def test_an_uncertainty_that_is_not_known_is_no_number(tmp_path, missing):
    p = calfit.read(make.put(tmp_path, "A.TPF", make.changed(make.tpf(), missing, None)))
    b, u, _ = p.apply(*RAW, 5.0)
    assert np.isfinite(b).all() and np.isnan(u).all()
    assert any(missing in note for note in p.notes)


def test_a_run_without_uncertainties(tmp_path):
    cpf = make.changed(make.cpf(), "std", None)
    p = calfit.read(make.put(tmp_path, "A.CPF", cpf))
    for frame in ("sensor", "coil"):
        b, u, _ = p.apply(*RAW, frame=frame)
        assert np.isfinite(b).all() and np.isnan(u).all()
