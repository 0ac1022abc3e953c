"""Where cells are measured: layers and their weights."""

import numpy as np
import pytest

from jaxtissue.geometry.tube import Tube
from jaxtissue.measurement.quadrature import layer_rule


@pytest.mark.parametrize("ratio", [1.0001, 2.0, 10.0, 1000.0])
@pytest.mark.parametrize("layers", [1, 2, 3, 8, 64])
def test_layers_lie_within_the_wall_and_are_exact_for_what_is_linear(layers: int, ratio: float) -> None:
    tube = Tube(3.0, 7.0, 7.0 * ratio)
    radius, weight = layer_rule(tube, layers)
    assert len(radius) == len(weight) == layers
    assert tube.apical_radius < radius[0] and radius[-1] < tube.basal_radius
    assert (np.diff(radius) > 0).all() and (weight > 0).all()
    wall = tube.basal_radius - tube.apical_radius
    assert weight.sum() == pytest.approx(wall, rel=1e-9)
    assert 2 * np.pi * tube.length * (weight @ radius) == pytest.approx(tube.volume, rel=1e-9)


def test_layers_follow_a_section_that_has_kinks_better_than_a_polynomial_does() -> None:
    tube, places = Tube(1.0, 1.0, 10.0), np.geomspace(1.2, 9.0, 200)
    node, share = np.polynomial.legendre.leggauss(6)
    rules = layer_rule(tube, 6), (5.5 + 4.5 * node, 4.5 * share)
    off = [
        [weight @ np.maximum(radius - place, 0) ** 2 - (10 - place) ** 3 / 3 for place in places]
        for radius, weight in rules
    ]
    spline, polynomial = np.std(off, axis=1)
    assert spline < 0.8 * polynomial
