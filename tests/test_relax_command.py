"""The command that relaxes a tissue: what it leaves, and from what it goes on."""

import csv
import json

import numpy as np
import pytest

from jaxtissue.cli.commands import main
from jaxtissue.geometry.tube import Tube
from jaxtissue.runs.run_folders import read_tissue

pytestmark = pytest.mark.usefixtures("coarse_pictures")
TUBE = ("--length", "16", "--apical-radius", "2", "--basal-radius", "5", "--cells", "60", "--seed", "2")


@pytest.fixture(scope="module")
def relaxed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("relax") / "run"
    assert main(["relax", *TUBE, "--steps", "3", "--out", str(folder)]) == 0
    return folder


def test_relax_leaves_the_files_of_its_contract(relaxed):
    manifest = json.loads((relaxed / "manifest.json").read_text())
    with (relaxed / "steps.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header == ["step", "evaluations", "energy", "gradient", "seconds"] and len(rows) == 4
    energies = [float(row[2]) for row in rows]
    assert energies == sorted(energies, reverse=True) and energies[-1] < 0.7 * energies[0]
    assert manifest["energy"]["final"] == energies[-1] and manifest["command"] == "relax"
    assert manifest["energy"]["final_measured"] == pytest.approx(energies[-1], rel=0.05)  # traced against draft
    for name in ("cells.csv", "contacts.csv", "transitions.csv", "energy.png", "volumes.png", "surfaces.png"):
        assert (relaxed / name).stat().st_size > 100, name
    tissue = read_tissue(relaxed)
    assert len(tissue.positions) == 60 and isinstance(tissue.domain, Tube) and float(tissue.domain.apical_radius) == 2


def test_a_relaxation_goes_on_from_its_backbones(relaxed, tmp_path, capsys):
    more = ["relax", "--backbones", str(relaxed / "backbones.csv"), "--domain", str(relaxed / "domain.json")]
    assert main([*more, "--method", "lloyd", "--steps", "0", "--no-contacts", "--out", str(tmp_path / "more")]) == 0
    before, after = (np.loadtxt(folder / "backbones.csv", delimiter=",", skiprows=1)
                     for folder in (relaxed, tmp_path / "more"))  # fmt: skip
    np.testing.assert_allclose(after, before, atol=1e-5)
    capsys.readouterr()
    assert main(["relax", *TUBE, "--method", "newton", "--out", str(tmp_path / "no")]) == 2
    assert "newton" in capsys.readouterr().err and not (tmp_path / "no").exists()
