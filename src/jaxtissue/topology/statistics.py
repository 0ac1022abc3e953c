"""Statistics of contacts: neighbors by kind, scutoids, polygon classes, the contact graph."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import networkx as nx
import numpy as np
from jaxtyping import ArrayLike, Bool, Float

from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.positions import as_positions
from jaxtissue.geometry.tube import Tube
from jaxtissue.topology.contacts import Contacts, find_contacts, find_faces
from jaxtissue.topology.domain_connectivity import connect_domain
from jaxtissue.topology.edges import trace_edges
from jaxtissue.topology.traced_sizes import TracedSizes, find_ends, traced_sizes
from jaxtissue.topology.transitions import CellForms, Transitions, find_forms, find_transitions

KIND_ORDER = ("apical_basal", "apical", "basal", "internal")
SURFACES = {"apical": ("apical_basal", "apical"), "basal": ("apical_basal", "basal"), "all": KIND_ORDER}


@dataclass(frozen=True)
class Connectivity:
    """The contacts, transition points, forms and sizes of the cells of a tissue.

    Attributes:
        contacts: The pairs of cells that share a wall.
        transitions: The transition points.
        forms: Which cells go round the lumen, and the number of pieces of each cell.
        is_end: Whether each cell touches an end of the tissue, x = 0 or x = L in a tube, [n].
        sizes: The sizes of all cells, in 64 bits; None where edges could not be followed, and on other domains.
        stretch_anisotropy: The ratio of the larger to the smaller stretch from the apical to the basal surface at each
            backbone, (1 + k_1 h) / (1 + k_2 h) or its inverse for curvatures k_1 and k_2, [n]; None for a `Tube`, where
            it is R_b / R_a throughout.
    """

    contacts: Contacts
    transitions: Transitions
    forms: CellForms
    is_end: Bool[np.ndarray, " n"]
    sizes: TracedSizes | None = None
    stretch_anisotropy: Float[np.ndarray, " n"] | None = None


def find_connectivity(
    positions: Float[ArrayLike, "n d"], domain: Tube | Domain, threshold: float = 0.0
) -> Connectivity:
    """Find which cells touch, and where they exchange neighbors along their height (paper, section 4.4).

    Beside contacts and transition points this gives the form of each cell (whether it goes all the way round the lumen,
    and the number of its connected parts), whether it touches an end of the tube, and its size. In a `Tube` all come
    from one tracing of the edges of the Voronoi diagram, in 64 bits.

    On other domains the cells of the apical surface are followed up to the basal one, layer by layer, in 64 bits. Where
    four cells exchange neighbors, their transition point is found by Newton's method; layers are added until every
    change between two of them is explained by such points, and a warning counts those that are not. Cells that go all
    the way round, and parts of cells that are cut off, are not followed there.

    Args:
        positions: (axial, angle) of each backbone, [n, 2], in any form that `as_positions` takes; on other domains
            than a tube their coordinates, [n, 2], or unit vectors, [n, 3].
        domain: The tube that the backbones stand in, or any other domain.
        threshold: Walls smaller than this fraction of the mean wall area are left out of the contacts; no other result
            depends on it.

    Returns:
        The results, in one record.

    Raises:
        ValueError: If `as_positions` refuses the positions, if the threshold is negative or not a number, or, on other
            domains than a `Tube`, if a cell goes all the way round or touches its own copy.

    >>> four = find_connectivity([[2, 0.5], [2, -0.5], [1.2, 0], [2.8, 0]], Tube(4, 1, 2))
    >>> len(four.contacts.pairs), four.transitions.per_cell.tolist(), four.is_end.tolist()
    (6, [1, 1, 1, 1], [False, False, True, True])
    """
    if not threshold >= 0:
        raise ValueError(f"threshold={threshold}; give a fraction of the mean wall, 0 or more")
    if isinstance(domain, Domain):
        return Connectivity(**connect_domain(positions, domain, threshold)._asdict())
    place = as_positions(positions, domain, np.float64)
    edges = trace_edges(place, domain)
    faces = find_faces(edges)
    return Connectivity(
        find_contacts(place, domain, threshold, edges, faces),
        find_transitions(place, domain, edges, faces),
        find_forms(place, domain, edges, faces),
        find_ends(edges),
        traced_sizes(edges, faces, domain),
    )


def tabulate_connectivity(connectivity: Connectivity) -> dict[str, np.ndarray]:
    """The columns that connectivity adds to the table of cells (paper, section 4.4).

    Args:
        connectivity: The result of `find_connectivity`.

    Returns:
        Columns [n] by name. `neighbors` counts all neighbors of a cell. `apical_basal_neighbors`, `apical_neighbors`,
        `basal_neighbors` and `internal_neighbors` split them by the surfaces that the common wall reaches: both, the
        apical one only, the basal one only, or neither. `transitions` counts the transition points of the cell, and
        `is_scutoid` tells whether it has any. `is_ring` tells whether the cell goes all the way round the lumen, and
        `pieces` is the number of its connected parts. On other domains than a `Tube` there is `stretch_anisotropy`.

    >>> four = find_connectivity([[2, 0.5], [2, -0.5], [1.2, 0], [2.8, 0]], Tube(4, 1, 2))
    >>> tabulate_connectivity(four)["neighbors"].tolist()
    [3, 3, 3, 3]
    """
    contacts, forms = connectivity.contacts, connectivity.forms
    columns = {"neighbors": contacts.degree()}
    columns |= {f"{kind}_neighbors": contacts.degree(kind) for kind in KIND_ORDER}
    columns |= {"transitions": connectivity.transitions.per_cell}
    columns |= {"is_scutoid": connectivity.transitions.is_scutoid}
    columns |= {"is_ring": forms.is_ring, "pieces": forms.pieces}
    stretch = connectivity.stretch_anisotropy
    return columns if stretch is None else columns | {"stretch_anisotropy": stretch}


def summarize_connectivity(connectivity: Connectivity, inner_only: bool = False) -> dict[str, float]:
    """Means over the cells of neighbors, degrees and transition points, and fractions of cells (paper, section 4.4).

    `identity_residual` is mean neighbors - mean apical degree - mean transition points / 2. It is 0 where no cell wraps
    round the lumen, no two cells touch twice, and no threshold or end leaves out a part.

    Args:
        connectivity: The result of `find_connectivity`.
        inner_only: Whether cells that touch an end of the tube are left out.

    Returns:
        Values by name; `transitions_max` is the largest count of a cell. All are not numbers where no cell is left.

    >>> four = find_connectivity([[2, 0.5], [2, -0.5], [1.2, 0], [2.8, 0]], Tube(4, 1, 2))
    >>> summary = summarize_connectivity(four)
    >>> summary["neighbors"], summary["apical_degree"], summary["scutoid_fraction"]
    (3.0, 2.5, 1.0)
    """
    columns = tabulate_connectivity(connectivity)
    chosen = ~connectivity.is_end if inner_only else np.ones(len(connectivity.is_end), bool)
    for surface in ("apical", "basal"):
        columns[f"{surface}_degree"] = connectivity.contacts.degree(*SURFACES[surface])
    residual = columns["neighbors"] - columns["apical_degree"] - columns["transitions"] / 2
    columns["identity_residual"] = residual
    columns["with_internal"] = columns["internal_neighbors"] > 0
    columns["detached"] = columns["pieces"] > 1
    names = ("neighbors", *(f"{kind}_neighbors" for kind in KIND_ORDER))
    mean = {name: _mean(column[chosen]) for name, column in columns.items()}
    summary = {name: mean[name] for name in (*names, "apical_degree", "basal_degree", "transitions")}
    summary["transitions_max"] = float(columns["transitions"][chosen].max()) if chosen.any() else math.nan
    summary |= {"scutoid_fraction": mean["is_scutoid"], "internal_fraction": mean["with_internal"]}
    summary |= {"ring_fraction": mean["is_ring"], "detached_fraction": mean["detached"]}
    return summary | {"identity_residual": mean["identity_residual"]}


def polygon_classes(
    connectivity: Connectivity,
    areas: Float[ArrayLike, " n"],
    surface: str = "apical",
    inner_only: bool = True,
) -> dict[str, np.ndarray]:
    """Group cells by their number of sides on a surface: how many, how large, and with how many-sided neighbors.

    A side is a neighbor that touches on the surface. m(n) is the mean number of sides over all pairs of a cell with n
    sides and a neighbor. Section 4.4 of the paper counts neighbors by surface; the laws of Lewis and Aboav-Weaire are
    not in it.

    Args:
        connectivity: The result of `find_connectivity`.
        areas: The areas of the cells on the surface, [n], in any unit.
        surface: "apical" or "basal", or "all" for neighbors anywhere.
        inner_only: Whether cells that touch an end of the tube, which lack sides, are left out, also as neighbors.

    Returns:
        Columns with a row for each number of `sides`, rising: `count` and `fraction` of the cells; `relative_area`,
        mean area / mean area of all cells (Lewis); `neighbor_sides`, m(n), not a number where there is no neighbor; and
        `sides_times_neighbor_sides`, n m(n) (Aboav-Weaire: linear in n).

    Raises:
        ValueError: If the surface is unknown, or if the areas are not one for each cell.

    >>> four = find_connectivity([[2, 0.5], [2, -0.5], [1.2, 0], [2.8, 0]], Tube(4, 1, 2))
    >>> table = polygon_classes(four, [1, 1, 2, 2], inner_only=False)
    >>> table["sides"].tolist(), table["count"].tolist(), table["neighbor_sides"].round(2).tolist()
    ([2, 3], [2, 2], [3.0, 2.33])
    """
    if surface not in SURFACES:
        raise ValueError(f"surface={surface!r} is none of {', '.join(SURFACES)}; choose one of them")
    contacts, sides = connectivity.contacts, connectivity.contacts.degree(*SURFACES[surface])
    size = np.asarray(areas, float)
    if size.shape != sides.shape:
        raise ValueError(f"areas have shape {size.shape}; give one for each of the {len(sides)} cells")
    chosen = ~connectivity.is_end if inner_only else np.ones(len(sides), bool)
    pairs = contacts.pairs[np.isin(contacts.kind, SURFACES[surface])]
    pairs = pairs[chosen[pairs].all(axis=1)]
    cell, other = np.concatenate([pairs, pairs[:, ::-1]]).T
    classes, at = np.unique(sides[chosen], return_inverse=True)
    count = np.bincount(at, minlength=len(classes))
    row, shape = np.searchsorted(classes, sides[cell]), len(classes)
    with np.errstate(divide="ignore", invalid="ignore"):
        around = np.bincount(row, sides[other], shape) / np.bincount(row, minlength=shape)
        relative = np.bincount(at, size[chosen], shape) / count / _mean(size[chosen])
    table = {"sides": classes, "count": count, "fraction": count / max(count.sum(), 1)}
    table |= {"relative_area": relative, "neighbor_sides": around}
    return table | {"sides_times_neighbor_sides": classes * around}


def tissue_graph(connectivity: Connectivity, columns: Mapping[str, np.ndarray] | None = None) -> nx.Graph:
    """The contact graph of a tissue: a node for each cell and an edge for each contact (paper, section 4.4).

    All attributes are plain Python values, so that `networkx.write_graphml` and similar functions take the graph.

    Args:
        connectivity: The result of `find_connectivity`.
        columns: Values of each cell, [n] by name; the columns of `tabulate_connectivity` if None.

    Returns:
        The graph. Nodes have the values of `columns`; edges have `area`, `apical_length`, `basal_length`, `kind` and
        `pieces`.

    >>> four = find_connectivity([[2, 0.5], [2, -0.5], [1.2, 0], [2.8, 0]], Tube(4, 1, 2))
    >>> graph = tissue_graph(four)
    >>> graph.nodes[0]["neighbors"], graph.edges[0, 1]["kind"]
    (3, 'apical_basal')
    """
    contacts, graph = connectivity.contacts, nx.Graph()
    columns = tabulate_connectivity(connectivity) if columns is None else columns
    for cell in range(contacts.cells):
        graph.add_node(cell, **{name: np.asarray(column)[cell].item() for name, column in columns.items()})
    names = ("area", "apical_length", "basal_length", "kind", "pieces")
    values = zip(*(getattr(contacts, name).tolist() for name in names), strict=True)
    for (first, second), row in zip(contacts.pairs.tolist(), values, strict=True):
        graph.add_edge(first, second, **dict(zip(names, row, strict=True)))
    return graph


def _mean(values: np.ndarray) -> float:
    return float(values.mean(dtype=float)) if len(values) else math.nan
