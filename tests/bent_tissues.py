"""Tissues of tilted and bent backbones for several tests."""

import numpy as np

import jaxtissue as jt
from jaxtissue.geometry.domain_positions import as_domain_positions


def evenly_bent(domain, cells: int, nodes: int, way: float) -> np.ndarray:
    """Backbones spread evenly, whose nodes are off by a part of the tissue's width, each by its own random way."""
    number, random = np.arange(cells), np.random.default_rng(1)
    if isinstance(domain, jt.Sphere):
        z, turn = 1 - (2 * number + 1) / cells, number * np.pi * (3 - np.sqrt(5))
        place = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=1)[:, None]
        return as_domain_positions(place + random.uniform(-way, way, (cells, nodes, 3)), domain, float, bent=True)
    row, column = np.divmod(number, 5)
    place = np.stack([(row + 0.5) / (cells / 5), (column + 0.25 + row % 2 / 2) / 5], axis=1)[:, None]
    place = np.clip(place + random.uniform(-way, way, (cells, nodes, 2)), 0.01, 0.99)
    return as_domain_positions(place * [float(side) for side in domain.base.extent], domain, float, bent=True)
