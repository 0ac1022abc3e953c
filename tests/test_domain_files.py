"""Files of domains: what is written is read back, what can't be a domain is refused in one line."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

import jaxtissue as jt
from jaxtissue.cli.commands import main
from jaxtissue.geometry.domain_files import flag, load_tube, number, read_domain, save_domain, several
from jaxtissue.geometry.domain_positions import column_names
from jaxtissue.runs import storage
from jaxtissue.runs.backbone_files import read_backbones

pytestmark = pytest.mark.usefixtures("coarse_pictures")
SIZES = {"shape": "tube", "length": 12, "apical_radius": 2, "basal_radius": 4}
FLAGS = ("--length", "12", "--apical-radius", "2", "--basal-radius", "4")


@pytest.fixture
def backbones(tmp_path):
    path = tmp_path / "backbones.csv"
    path.write_text("axial,angle\n1,0\n5,2\n9,4\n")
    return str(path)


@pytest.mark.parametrize("tube", [jt.Tube(0.1, 1 / 3, 7), jt.Tube(jnp.float32(12.5), np.float32(2), 4)])
def test_a_domain_reads_back_to_the_bit(tmp_path, tube):
    path = tmp_path / "domain.json"
    save_domain(tube, path)
    again = jt.load_domain(path)
    assert all(float(getattr(tube, name)) == getattr(again, name) for name in ("length", "apical_radius"))
    assert json.loads(path.read_text())["periodic"] is False
    save_domain(again, path)
    assert jt.load_domain(str(path)) == again


def test_only_domains_are_written(tmp_path):
    with pytest.raises(ValueError, match="a dict cannot be written to a file; give one of the shapes tube"):
        save_domain(SIZES, tmp_path / "domain.json")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "not valid JSON"),
        ("\xff", "not valid JSON"),
        ("[1, 2]", "no JSON object"),
        ("{}", '"shape" is missing; add it, with one of the values tube'),
        (json.dumps(SIZES | {"shape": "cone"}), "shape='cone' is unknown; give one of tube"),
        (json.dumps(SIZES | {"shape": ["tube"]}), "is unknown"),
        (json.dumps(SIZES | {"width": 3}), "'width' is not a size of the shape 'tube'"),
        (
            '{"shape": "tube", "length": 12, "apical_radius": 2}',
            "the size 'basal_radius' of the shape 'tube' is missing; add it",
        ),
        ('{"shape": "tube", "length": 1, "length": 2}', "'length' is given twice"),
        (
            json.dumps(SIZES | {"length": float("nan")}),
            "length=NaN of the shape 'tube' is invalid; it must be a finite number",
        ),
        (
            json.dumps(SIZES | {"length": "12"}),
            "length=\"12\" of the shape 'tube' is invalid; it must be a finite number",
        ),
        (
            json.dumps(SIZES | {"length": True}),
            "length=true of the shape 'tube' is invalid; it must be a finite number",
        ),
        (json.dumps(SIZES | {"length": 10**400}), "it must be a finite number"),
        (json.dumps(SIZES | {"length": -1}), "length=-1.0 is not a positive finite number"),
        (json.dumps(SIZES | {"basal_radius": 1}), "apical_radius=2.0 is not smaller than basal_radius=1.0"),
        (json.dumps(SIZES | {"periodic": 0}), "periodic=0 of the shape 'tube' is invalid; it must be true or false"),
    ],
)
def test_what_is_no_domain_is_refused_in_one_line(tmp_path, text, told):
    path = tmp_path / "domain.json"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(ValueError) as error:
        jt.load_domain(path)
    assert told in str(error.value) and str(path) in str(error.value) and "\n" not in str(error.value)


def test_lists_of_sizes_are_read():
    assert several(2, number)([1, 2.5]) == (1.0, 2.5) and several(1, flag)([True]) == (True,)
    with pytest.raises(ValueError, match="it must be a list of 2 values"):
        several(2, number)([1])
    assert read_domain(SIZES | {"periodic": False}) == jt.Tube(12, 2, 4)


def test_commands_take_the_file_in_place_of_the_sizes(tmp_path, backbones, capsys):
    domain = tmp_path / "domain.json"
    domain.write_text(json.dumps(SIZES))
    for name, sizes in (("sizes", FLAGS), ("file", ("--domain", str(domain)))):
        assert main(["measure", backbones, *sizes, "--no-contacts", "--out", str(tmp_path / name)]) == 0
    assert (tmp_path / "sizes/cells.csv").read_bytes() == (tmp_path / "file/cells.csv").read_bytes()
    run = ["anneal", "--domain", str(domain), "--backbones", backbones, "--sweeps", "0", "--no-contacts"]
    assert main([*run, "--out", str(tmp_path / "run")]) == 0
    arguments = json.loads((tmp_path / "run/manifest.json").read_text())["arguments"]
    assert {name: arguments[name] for name in SIZES if name != "shape"} == {
        name: size for name, size in SIZES.items() if name != "shape"
    }
    assert main([*run, "--out", str(tmp_path / "run"), "--resume"]) == 0
    capsys.readouterr()
    for bad, told in (
        (["measure", backbones, "--domain", str(domain), *FLAGS[:2], "--out", "o"], "this option or --domain"),
        (["anneal", "--domain", str(domain), *FLAGS[2:4], "--out", "o"], "--apical-radius conflicts with the domain"),
        (["measure", backbones, *FLAGS[:4], "--out", "o"], "missing --basal-radius"),
        (["compare", backbones, "--domain", str(tmp_path / "none.json")], "can't be read"),
    ):
        assert main(bad) == 2
        error = capsys.readouterr().err
        assert told in error and error.count("\n") == 1


@pytest.mark.parametrize(
    "domain",
    [
        jt.RoundTube(10, 1, 2, periodic=True),
        jt.RoundTube(10, 1, 2),
        jt.Slab(4, 3, 2, periodic=(True, False)),
        jt.EllipticTube(10, [1, 2], [2, 3]),
        jt.BentTube(5, 1.5, 1, 2),
        jt.Sphere(1, 2),
        jt.Ellipsoid([2, 1, 1], [2.5, 1.5, 1.5]),
        jt.Fold(8, 4, 0.5, 4, 0.5),
    ],
)
def test_every_shape_is_written_and_read_with_its_backbones(tmp_path, domain):
    save_domain(domain, tmp_path / "domain.json")
    again = jt.load_domain(tmp_path / "domain.json")
    assert type(again) is type(domain)
    assert getattr(again.base, "directions", None) == getattr(domain.base, "directions", None)
    assert again.volume == pytest.approx(domain.volume, rel=1e-12)
    with pytest.raises(ValueError, match="is not a tube with ends"):
        load_tube(tmp_path / "domain.json")
    place, table = np.random.default_rng(0).uniform(0.1, 0.9, (5, len(domain.columns))), tmp_path / "backbones.csv"
    storage.write_backbones(table, place, list("abcde"), column_names(domain))
    assert table.read_text().startswith(",".join(domain.columns))
    read = read_backbones(table, domain)
    size = np.linalg.norm(place, axis=1, keepdims=True) if "nx" in domain.columns else 1
    np.testing.assert_allclose(read.positions, place / size, rtol=1e-15)  # unit vectors are normalized
    assert read.names == tuple("abcde")
    if "angle" not in domain.columns:
        with pytest.raises(ValueError, match="--degrees applies to angles"):
            read_backbones(table, domain, degrees=True)
    table.write_text("axis,angles\n1,2\n")
    with pytest.raises(ValueError, match=f"give the header {','.join(domain.columns)}"):
        read_backbones(table, domain)
