"""Backbones that merge, since the tension makes their cells collapse."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from jaxtissue.energy import Model, epithelial_energy
from jaxtissue.geometry.domain_positions import nodes_in_space

MERGED = 1e-3  # mean cell widths between two backbones that are as good as one
STIFF = 0.3  # the relative tension up to which cells keep most of their volume


def told_of_merging(before: Float[np.ndarray, "n *k d"], after: Float[np.ndarray, "n *k d"], model: Model) -> str:
    """Which two cells collapse on the way from one tissue to another, and why; empty if none do."""
    if len(after) < 2:
        return ""
    old, new = (nodes_in_space(place, model.domain).reshape(len(after), -1) for place in (before, after))
    gaps, numbers = map(np.asarray, KDTree(new).query(new, 2))
    cell = int(gaps[:, 1].argmin())
    other = int(next(number for number in numbers[cell] if number != cell))
    pair = sorted((cell, other))
    nodes = new.shape[1] // 3
    near = MERGED * _width(new.reshape(-1, nodes, 3), model) * nodes**0.5
    if gaps[cell, 1] >= min(near, np.linalg.norm(old[cell] - old[other])):
        return ""
    told = f"cells {pair[0]} and {pair[1]} collapse, as their backbones meet"
    if model.cell_energy is not epithelial_energy:
        return f"{told}: the energy does not hold them apart"
    size = float(model.modulus) * float(model.mean_volume) ** (4 / 3)
    relative = float(model.tension) / size if size > 0 else np.inf
    if relative <= STIFF:
        return f"{told}: a smaller tension would hold them apart"
    cure = f"cells need at most about {STIFF} to keep their volume, so give a tension of at most {STIFF * size:.2g}"
    return f"{told}: the tension is {relative:.2g} times modulus x (mean volume)^(4/3); {cure}"


def _width(nodes: Float[np.ndarray, "n k 3"], model: Model) -> float:
    """The width of a mean cell: the square root of its volume over its height."""
    height = np.linalg.norm(np.diff(nodes, axis=1), axis=-1).sum(axis=1).mean()
    return float(np.sqrt(float(model.mean_volume) / height))
