"""Published numbers, to set beside ours.

The paper's are from its text and Table 1, or read off the axes of its figures; the gland's are the means of
80 cells of eight wild-type fly larval salivary glands.
"""

from typing import NamedTuple

GLAND_SOURCE = "Gomez-Galvez et al., Nat. Commun. 9, 2960 (2018)"


class Timing(NamedTuple):
    """A row of the paper's Table 1: seconds per step on a laptop with 4 cores, and rounds of IS-MH."""

    mh_seconds: float
    is_mh_seconds: float
    rounds: int


class Gland(NamedTuple):
    """Measurements on glands: range of R_b / R_a, mean neighbors and transitions, share of scutoids."""

    ratios: tuple[float, float]
    section_neighbors: float
    neighbors: float
    transitions: float
    scutoid_fraction: float


TABLE_1 = {
    (1.0, 100): Timing(47.1, 15.6, 17),
    (1.0, 500): Timing(703.8, 54.6, 20),
    (1.0, 1000): Timing(2525.0, 103.7, 21),
    (5.0, 100): Timing(56.1, 10.8, 10),
    (5.0, 500): Timing(712.8, 42.4, 14),
    (5.0, 1000): Timing(2597.2, 76.7, 15),
}
SPEED_UP = 25.0  # "up to factor of 25"
CELL_BEFORE, CELL_AFTER, CELL_MEAN = 9.0, 40.0, 44.0  # volumes, Fig. 5
START_ENERGY = (300_000.0, 350_000.0)  # read off Fig. 10
TIGHTNESS, TIGHTNESS_RANGE = 3.0, (1.0, 5.0)  # caption of Fig. 11; section 4.3
NEIGHBORS = {1.25: 6.0, 200.0: 10.5}  # read off Fig. 12
NEIGHBORS_BELOW = (1000.0, 11.0)  # section 4.4
SCUTOIDS_ABOVE = (2.0, 0.9)  # caption of Fig. 13
INTERNAL_FRACTION = (10.0, 0.65)  # section 4.4
INTERNAL_NEIGHBORS = 1.0  # "does not go substantially above one"
GLAND = Gland((4.0, 10.0), 6.18, 7.05, 1.79, 0.875)
