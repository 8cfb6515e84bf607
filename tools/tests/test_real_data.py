"""Campaigns made of measured data: what is added and what is averaged, in closed form."""

import subprocess
import sys
from pathlib import Path

import pytest

np = pytest.importorskip("numpy", reason="the package numpy is not there")

TOOLS = Path(__file__).parents[1]
CHAMP = TOOLS.parent / "runs" / "champ-1998"


def run(tool, *arguments):
    return subprocess.run([sys.executable, TOOLS / tool, *map(str, arguments)], capture_output=True, text=True)


def rows(path, header):
    lines = path.read_text().splitlines()
    begin = lines.index(header) + 1
    end = next(i for i in range(begin, len(lines)) if lines[i].startswith("@"))
    return np.array([[float(value) for value in line.split(",")] for line in lines[begin:end]])


def blocks(folder):
    (path,) = folder.glob("*/*.CCR")
    return rows(path, "t_start,t_end,bx,by,bz,position,x,y,z")


def test_plateaus_are_means_of_readings_that_agree(tmp_path):
    # Four readings in one field, two in another, three in a third one 20 s later; a temperature that rises by 1 K a line.
    fields = [10.0, 10.1, 10.1, 10.0, 40.0, 40.0, 20.0, 20.0, 20.05]
    times = [100, 100, 101, 101, 102, 102, 122, 122, 123]
    lines = [f"{t},{b},0.5,0,{b + 1},{2 * b},-3,{300.15 + k}" for k, (t, b) in enumerate(zip(times, fields, strict=True))]
    table = tmp_path / "full_data.csv"
    table.write_text("\n".join(lines) + "\n")
    done = run("mageval2campaign.py", table, "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("2 plateaus;")
    means = blocks(tmp_path / "out")
    expected = [[0, 2, 10050, 500, 0, 1, 11050, 20100, -3000], [22, 24, 60050 / 3, 500, 0, 1, 63050 / 3, 120100 / 3, -3000]]
    assert np.abs(means - expected).max() < 1e-3
    (path,) = (tmp_path / "out").glob("*/*.CCR")
    text = path.read_text().splitlines()
    warm = [line.split(",") for line in text[text.index("t,DUT") + 1 : text.index("@END")]]
    assert [float(t) for t, _ in warm[:4]] == [0.0, 0.5, 1.0, 1.5]
    assert [float(degc) for _, degc in warm] == pytest.approx([27.0 + k for k in range(9)])
    assert run("mageval2campaign.py", table, "-o", tmp_path / "each", "--each").stdout.startswith("9 plateaus;")


def test_a_line_that_is_no_reading_is_refused(tmp_path):
    table = tmp_path / "full_data.csv"
    table.write_text("1,2,3,4,5,6,7,8\n1,2,3,4,5,x,7,8\n")
    done = run("mageval2campaign.py", table, "-o", tmp_path / "out")
    assert done.returncode == 2 and "line 2" in done.stderr and not (tmp_path / "out").exists()


def test_one_effect_is_added_to_one_axis(tmp_path):
    done = run("champ_with_effects.py", CHAMP, "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    as_it_is = blocks(tmp_path / "out" / "none")
    assert len(as_it_is) == 80 and len(list((tmp_path / "out").iterdir())) == 13
    part = as_it_is[:, 2:5] / 60_000
    before = np.vstack([np.zeros(3), part[:-1]])
    for axis, name in enumerate("xyz"):
        added = {
            "step": 0.4 * (np.arange(80) >= 40),
            "cubic": 0.6 * part[:, axis] ** 3,
            "remanence": 0.3 * before[:, axis],
            "transverse": 0.4 * part[:, (axis + 1) % 3] ** 2,
        }
        for effect, size in added.items():
            change = blocks(tmp_path / "out" / f"{effect}-{name}") - as_it_is
            assert np.abs(change[:, 6 + axis] - size).max() < 1e-5, (effect, name)
            assert np.abs(np.delete(change, 6 + axis, axis=1)).max() == 0.0
