"""Tables as people have them: read whole and right, or refused with the line."""

import math
import warnings
from pathlib import Path

import numpy as np
import pytest

from jaxtissue.geometry.tube import Tube
from jaxtissue.runs.backbone_files import read_backbones

TABLES = Path(__file__).parent / "data" / "tables"
TUBE = Tube(20, 1, 3)
ONE = [[1, 0.5]]


@pytest.fixture
def table(tmp_path):
    """A function that writes text to a file and returns its path."""

    def write(text):
        path = tmp_path / "mine.csv"
        path.write_bytes(text.encode())
        return path

    return write


@pytest.mark.parametrize(
    "name, places, names",
    [
        ("semicolon.csv", ONE, None),
        ("tab.tsv", ONE, None),
        ("upper.csv", ONE, None),
        ("units.csv", ONE, None),
        ("index_col.csv", [[1, 0.5], [2, 1.5]], ("0", "1")),
        ("name_dup_type.csv", [[1, 0.5], [2, 1.5]], ("1", "2")),
        ("control_name.csv", [[1, 0.5], [5, 1.5], [9, 2.5]], ("a\x0bb", "c\x1b[31m", "d")),
    ],
)
def test_tables_that_people_have_are_read(name, places, names):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read = read_backbones(TABLES / name, TUBE)
    assert read.positions.tolist() == places and read.names == names


def test_good_tables_are_read_whole():
    assert read_backbones(TABLES / "base.csv", TUBE).names == tuple(f"c{k}" for k in range(30))
    assert len(read_backbones(TABLES / "square_lattice_10x8.csv", TUBE).positions) == 80


def test_a_rounding_beyond_an_end_is_put_on_it(table):
    read = read_backbones(TABLES / "float32_end.csv", Tube(20.1, 1, 3))
    assert read.positions[:, 0].tolist() == [20.1, 5, 9]
    assert read_backbones(table("axial,angle\n-1e-17,1\n"), TUBE).positions.tolist() == [[0, 1]]


def test_degrees_are_read_as_told_and_doubted_else(table):
    told = read_backbones(TABLES / "degrees.csv", TUBE, degrees=True)
    np.testing.assert_allclose(told.positions, [[1, math.radians(10)], [2, math.radians(12)]])
    with pytest.warns(UserWarning, match="angles up to 12, which are read as radians; add --degrees"):
        read_backbones(TABLES / "degrees.csv", TUBE)
    for unit in ("deg", "°", "Degrees"):
        headed = read_backbones(table(f"axial [mm],angle ({unit})\n1,10\n2,12\n"), TUBE)
        assert headed.positions.tolist() == told.positions.tolist()
    with pytest.raises(ValueError, match=r"header 'axial,angle \(rad\)' gives angles in 'rad'; remove --degrees"):
        read_backbones(table("axial,angle (rad)\n1,1\n"), TUBE, degrees=True)
    with pytest.raises(ValueError, match=r"header 'axial,angle \(turns\)' gives angles in 'turns'"):
        read_backbones(table("axial,angle (turns)\n1,1\n"), TUBE)


@pytest.mark.parametrize(
    "text, places, names",
    [
        ("axial;angle\n1,5;0,25\n2;1e-1\n", [[1.5, 0.25], [2, 0.1]], None),
        ("angle\taxial\tnote\n0,5\t1,5\ta, b\n", [[1.5, 0.5]], None),
        ('"Axial";"Angle";"Label"\n"1,5";"0,5";"x;y"\n', [[1.5, 0.5]], ("x;y",)),
        (" AXIAL , Angle ,Id\n1,.5,7\n", [[1, 0.5]], ("7",)),
        ("Unnamed: 0,axial,angle\n4,1,0.5\n", [[1, 0.5]], ("4",)),
        ("axial,angle,id\n1,0.5,7\n2,0.5,7\n", [[1, 0.5], [2, 0.5]], None),
        ("name,label,axial,angle\na,x,1,0.5\na,y,2,0.5\n", [[1, 0.5], [2, 0.5]], ("x", "y")),
        ("Nucleus,axial,angle\nn7,1,0.5\nn9,2,0.5\n", [[1, 0.5], [2, 0.5]], ("n7", "n9")),
        ("height,axial,angle\n1.5,1,0.5\n2,2,0.5\n", [[1, 0.5], [2, 0.5]], None),
        ("batch,axial,angle\n3,1,0.5\n3,2,0.5\n", [[1, 0.5], [2, 0.5]], None),
        ("axial,angle,,\n1,0.5,,\n", ONE, None),
        ('axial,angle,note\n1,0.5,"two\nlines"\n2,1,ok\n', [[1, 0.5], [2, 1]], None),
        ("axial,angle\r1,0.5\r", ONE, None),
        ("\naxial,angle\n\n1,+0.5\n\n", ONE, None),
    ],
)
def test_other_tables_are_read(table, text, places, names):
    read = read_backbones(table(text), TUBE)
    assert read.positions.tolist() == places and read.names == names


REFUSED = {
    'axial,angle,note\n1,.5,"a\n2,1,ok\n3,2,"\n': "line 2 has an unclosed quotation mark that includes line 3, '2,1",
    'axial;angle;note\n1;0,5;"a\n2;0,5;ok\n3;2;b"\n': "line 2 has an unclosed quotation mark that includes line 3",
    'axial,angle,note\n1,.5,"a"b\n': "line 2 has a quotation mark",
    "axial,angle,Axial (um)\n1,0.5,2\n": "'axial' twice in 'axial,angle,Axial \\(um\\)'",
    "axial,angle,note,note\n1,0.5,2,3\n": "'note' twice",
    "axial,angle\n1,0x1\n": "line 2: angle='0x1' is not a finite number",
    "axial,angle\n1,\uff11\n": "line 2: angle='\uff11'",
    "axial;angle\n1.000,5;1\n": "decimal commas and decimal points|axial='1.000,5'",
    "axial;angle\n1,5;1\n2.5;1\n": "axial contains both decimal commas and decimal points",
    "axial;angle\n1,000,000;1\n": "axial='1,000,000'",
    'axial,angle\n"1,5",1\n': "axial='1,5'",
    "axial,angle\n1,0.5\naxial,angle\n2,1\n": "line 3: axial='axial'",
    "position along the axis,angle around the axis,the name of the cell,its type,its area\n": (
        "'position along the axis,angle around the axis,the name of the cell,its type,its area'"
    ),
    "axial,angle\n1,0.5\n25,1\n": "line 3: axial=25.0 is outside the tube; give a value from 0 to 20.0",
    "axial,angle\n\n1,0.5\n1,0.5\n": "lines 3 and 4 are the same backbone",
    "name,axial,angle\na,1,0.5\na,2,0.5\n": "line 3: name='a' is also on line 2",
}


@pytest.mark.parametrize("text", REFUSED, ids=repr)
def test_what_is_not_sure_is_refused_with_its_line(table, text):
    with pytest.raises(ValueError, match=REFUSED[text]) as refusal:
        read_backbones(table(text), TUBE)
    assert "mine.csv" in str(refusal.value) and "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    "name, words",
    [
        ("unclosed_quote.csv", "line 3 has a quotation mark that is not closed"),
        ("dup_header.csv", "the column 'axial' twice in 'axial,angle,axial'"),
        ("underscore.csv", "line 2: axial='1_0' is not a finite number"),
    ],
)
def test_tables_that_were_misread_are_refused(name, words):
    with pytest.raises(ValueError, match=words):
        read_backbones(TABLES / name, TUBE)
