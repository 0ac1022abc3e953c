"""Contacts, transition points and forms of the cells of any domain, found on its layers."""

import warnings
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtissue.compilation.modes import double_precision, usual_modes
from jaxtissue.geometry.array_likes import PositionsLike
from jaxtissue.geometry.base_surfaces import UnitSphere
from jaxtissue.geometry.domain_positions import as_domain_positions
from jaxtissue.geometry.domains import Domain, in_doubles
from jaxtissue.geometry.vectors import components, dot
from jaxtissue.topology.contacts import KINDS, ROUNDOFF, Contacts
from jaxtissue.topology.layer_gaps import LayerGaps
from jaxtissue.topology.layer_map import first_map
from jaxtissue.topology.layer_walls import WallPoints, surface_edges, wall_areas
from jaxtissue.topology.rising import TIE, Rise, cell_names, rise
from jaxtissue.topology.transitions import CellForms, Transitions

NARROW = 1e-9  # of the tissue's size: shorter edges are rounding
DOUBTED = 0.02  # of the mean wall: areas with a larger error are warned of


class DomainConnectivity(NamedTuple):
    """What is found of the cells of a domain; see `Connectivity`."""

    contacts: Contacts
    transitions: Transitions
    forms: CellForms
    is_end: Bool[np.ndarray, " n"]
    stretch_anisotropy: Float[np.ndarray, " n"]


def connect_domain(positions: PositionsLike, domain: Domain, threshold: float) -> DomainConnectivity:
    """The contacts, transition points and forms of cells on any domain, as `find_connectivity` says."""
    place = as_domain_positions(positions, domain, np.float64, bent=True)
    gaps = LayerGaps(domain, place)
    if len(place) == 1 and isinstance(domain.base, UnitSphere):
        return _alone(stretch_anisotropy(domain, gaps.apical))
    risen = rise(gaps, first_map(gaps, gaps.apical, 0.0))
    n, is_end = len(place), np.zeros(len(place) + 4, bool)
    quads = risen.pieces.quad
    is_end[quads[(quads[:, :2] >= n).any(axis=1), :2]] = True
    for junctions in (risen.apical, risen.basal):
        is_end[junctions.labels[(junctions.labels >= n).any(axis=1)]] = True
    contacts, walls = _find_contacts(gaps, risen, threshold)
    transitions = _find_transitions(gaps, risen, walls)
    forms = CellForms(np.zeros(n, bool), np.ones(n, int))
    return DomainConnectivity(contacts, transitions, forms, is_end[:n], stretch_anisotropy(domain, gaps.apical))


def _alone(stretch: Float[np.ndarray, " 1"]) -> DomainConnectivity:
    """The one cell of a closed tissue: no walls, and nothing to follow."""
    none, pairs = np.zeros(0), np.zeros((0, 2), int)
    contacts = Contacts(1, pairs, none, none, none, np.array(KINDS)[pairs[:, 0]], pairs[:, 0], none)
    transitions = Transitions(np.zeros((0, 3)), np.zeros((0, 4), int), np.zeros(1, int), 0, none)
    return DomainConnectivity(contacts, transitions, CellForms(np.zeros(1, bool), np.ones(1, int)),
                              np.zeros(1, bool), stretch)  # fmt: skip


def _find_transitions(gaps: LayerGaps, risen: Rise, walls: WallPoints) -> Transitions:
    """The flips of four cells within the tissue; a warning where some can't be vouched for."""
    n, flips = gaps.count, risen.flips
    real = (flips.labels < n).all(axis=1) & (flips.height > 0) & (flips.height < 1)
    labels, points = flips.labels[real], flips.point[real]
    checked, at = [points, walls.point], [labels, walls.pairs[:, [0, 0, 1, 1]]]
    for junctions in (risen.apical, risen.basal):
        spots = gaps.look(junctions.place, 0 * junctions.drift, junctions.at)
        order = np.sort(junctions.labels, axis=1)
        checked.append(spots.point)
        at.append(np.concatenate([order, order[:, 2:]], axis=1))
    names = np.concatenate(at)
    ahead, rival = gaps.ahead_of(np.concatenate(checked), names)
    nearer = np.flatnonzero(ahead < -10 * TIE * gaps.size)
    told = np.column_stack([names[nearer], rival[nearer]])
    lost = risen.unexplained + list(np.unique(np.sort(told, axis=1), axis=0))
    if lost:
        told = f"{len(lost)} neighbor changes of {cell_names(lost, n)} could not be resolved"
        told += ", so contacts and transition points may be missing, and areas of their walls wrong"
        warnings.warn(f"{told}; use more cells, or separate backbones that nearly coincide or cross", stacklevel=4)
    per_cell = np.bincount(labels.ravel(), minlength=n)
    return Transitions(points, labels, per_cell, len(lost), flips.height[real])


def _find_contacts(gaps: LayerGaps, risen: Rise, threshold: float) -> tuple[Contacts, WallPoints]:
    """The pairs of cells that share a wall, and points of these walls."""
    n, pieces = gaps.count, risen.pieces
    chosen = (pieces.quad[:, :2] < n).all(axis=1) & (pieces.high > pieces.low)
    pieces = type(pieces)(*(part[chosen] for part in pieces))
    (area, coarse), walls = wall_areas(gaps, pieces)
    pairs = np.sort(pieces.quad[:, :2], axis=1)
    life, number = np.unique(pieces.life, return_inverse=True)
    whole = np.bincount(number, area)
    keys, row = np.unique(pairs @ [n, 1], return_inverse=True)
    owner = np.zeros(len(life), int)
    owner[number] = row
    total = np.bincount(owner, whole, len(keys))
    error = np.bincount(row, np.abs(area - coarse), len(keys))
    mean = total.mean() if len(total) else 0.0
    count = np.bincount(owner, whole > ROUNDOFF * mean, len(keys)).astype(int)
    lengths = []
    for junctions in (risen.apical, risen.basal):
        edge, length = surface_edges(gaps, junctions)
        at = np.searchsorted(keys, np.sort(edge, axis=1) @ [n, 1])
        lengths.append(np.bincount(at, np.where(length > NARROW * gaps.size, length, 0), len(keys)))
    kind = np.array(KINDS)[(lengths[0] > 0) + 2 * (lengths[1] > 0)]
    kept = (count > 0) & (total >= max(threshold, ROUNDOFF) * total[count > 0].mean() if count.any() else False)
    names = np.stack(np.divmod(keys, n), axis=1)
    _warn_of_walls(names[kept], error[kept], total[kept])
    return Contacts(n, *(column[kept] for column in (names, total, *lengths, kind, count, error))), walls


def _warn_of_walls(
    pairs: Int[np.ndarray, "m 2"], error: Float[np.ndarray, " m"], area: Float[np.ndarray, " m"]
) -> None:
    """Warn of walls whose areas may be off by more than a part of the mean wall, naming the worst."""
    share = error / area.mean() if len(area) else error
    over = np.flatnonzero(~(share <= DOUBTED))
    if len(over):
        worst = over[np.argsort(-share[over])[:5]]
        named = ", ".join(f"{a}-{b} ({100 * share[k]:.2g} %)" for k, (a, b) in zip(worst, pairs[worst], strict=True))
        told = (
            f"the areas of {len(over)} of {len(pairs)} walls may be wrong by more than {100 * DOUBTED:g} % of the mean"
        )
        warnings.warn(f"{told}, between cells {named}; measure these cells with measure_tissue", stacklevel=5)


@usual_modes()
def stretch_anisotropy(domain: Domain, positions: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
    """The ratio of the larger to the smaller stretch from the apical to the basal surface at each backbone, [n].

    With curvatures k_1 and k_2 of the apical surface and backbones of length h along its normal it is
    (1 + k_1 h) / (1 + k_2 h), or its inverse: R_b / R_a on a tube, 1 on a sphere and a slab. In general it is the ratio
    of the singular values of the map from one surface to the other that takes point to point at the same position.
    """
    with double_precision():
        ends = [np.asarray(part) for part in _metrics(in_doubles(domain), jnp.asarray(positions))]
    apical, basal = (np.stack([np.stack([a, b], axis=-1), np.stack([b, c], axis=-1)], axis=-2) for a, b, c in ends)
    stretch = np.linalg.eigvals(np.linalg.solve(apical, basal)).real
    return np.sqrt(stretch.max(axis=1) / stretch.min(axis=1))


@jax.jit
def _metrics(domain: Domain, positions: jax.Array) -> jax.Array:
    """The three numbers of the metric of both surfaces, [2, 3, n]."""
    place, found = components(positions), []
    zero = jnp.zeros_like(place[0])
    for h in (0.0, 1.0):
        frame = domain.frame(place, (zero, zero), zero + h)
        found.append(jnp.stack([dot(frame.first, frame.first), dot(frame.first, frame.second),
                                dot(frame.second, frame.second)]))  # fmt: skip
    return jnp.stack(found)
