"""Connectivity statistics: neighbors by kind, scutoids, polygon classes, contact graph.

"The paper" is Buceta, Funke, Storandt, "Efficient Modeling of 3D Epithelial Cell Structure Dynamics via Backbone
Spreads", GRAPP 2025.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from jaxtissue.geometry.array_likes import ArrayLike, PositionsLike
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.nodes import domain_of
from jaxtissue.geometry.positions import as_positions
from jaxtissue.geometry.tube import Tube
from jaxtissue.topology.contacts import Contacts, find_contacts, find_faces
from jaxtissue.topology.domain_connectivity import connect_domain
from jaxtissue.topology.edges import trace_edges
from jaxtissue.topology.traced_sizes import TracedSizes, find_ends, traced_sizes
from jaxtissue.topology.transitions import CellForms, Transitions, find_forms, find_transitions

if TYPE_CHECKING:
    import networkx as nx

KIND_ORDER = ("apical_basal", "apical", "basal", "internal")
SURFACES = {"apical": ("apical_basal", "apical"), "basal": ("apical_basal", "basal"), "all": KIND_ORDER}


@dataclass(frozen=True)
class Connectivity:
    """Contacts, transition points, topology and geometry of the cells of a tissue, as returned by `find_connectivity`.

    Attributes:
        contacts: Pairs of cells that share a wall, a `Contacts`.
        transitions: Transition points, a `Transitions` with fields `points` (Cartesian coordinates, shape [k, 3]),
            `cells` (the four cells that meet at each, shape [k, 4]), `per_cell` (number per cell, shape [n]),
            `is_scutoid` (whether a cell has at least one, shape [n]), `open_ends` (number of edges of the diagram that
            could not be followed; if it is not 0, a warning says so, and contacts and transition points may be
            missing) and `height` (0 on the apical to 1 on the basal surface, shape [k]; None for a `Tube`).
        forms: Topology of the cells, with fields `is_ring` (whether a cell encircles the lumen, shape [n]) and `pieces`
            (number of connected components of a cell, shape [n]).
        is_end: Whether each cell touches an end of the domain (in a tube x = 0 or x = L), booleans, shape [n].
        sizes: Volume, areas and perimeters of each cell in float64, with the per-cell fields of `CellGeometry`. None if
            `open_ends` is not 0, and for domains other than `Tube`.
        stretch_anisotropy: Ratio of the larger to the smaller principal stretch from the apical to the basal surface at
            each backbone, at its apical end, shape [n]: (1 + k_1 h) / (1 + k_2 h) or its inverse, with the thickness h
            of the tissue and the principal curvatures k_1 and k_2 of the apical surface, positive if it bulges toward
            the basal one. None for a `Tube`, in which it is R_b / R_a everywhere.
    """

    contacts: Contacts
    transitions: Transitions
    forms: CellForms
    is_end: Bool[np.ndarray, " n"]
    sizes: TracedSizes | None = None
    stretch_anisotropy: Float[np.ndarray, " n"] | None = None

    def __repr__(self) -> str:
        cells, contacts, points = self.contacts.cells, len(self.contacts.pairs), len(self.transitions.points)
        told = f"{contacts} contacts, {points} transition points, {int(self.transitions.is_scutoid.sum())} scutoids"
        return f"Connectivity({cells} cells: {told})"


def find_connectivity(positions: PositionsLike, domain: Tube | Domain, threshold: float = 0.0) -> Connectivity:
    """Find which cells share a wall, and where they exchange neighbors between the surfaces (paper, section 4.4).

    In a `Tube`, the edges of the Voronoi diagram are traced in float64. They yield contacts, transition points, cells
    that encircle the lumen, connected components of cells, and the geometry of all cells.

    On other domains, the vertices of the cells on the apical surface are followed through layers of constant height to
    the basal surface, in float64, and transition points are located by Newton's method. Layers are refined until
    transition points explain every change between consecutive layers; a warning gives the number of unexplained
    changes, if any, and names their cells. There, `forms.is_ring` is False, `forms.pieces` is 1 and `sizes` is None for
    all cells.

    Args:
        positions: Axial position and angle in radians of each backbone, array-like of shape [n, 2] or a table with
            columns `axial` and `angle`; on other domains coordinates of shape [n, 2] or unit vectors of shape [n, 3].
            For tilted and bent backbones positions of nodes, shape [n, k, d], or [n, k, d + 1] with heights.
        domain: The tube or other domain. With nodes, a `Tube` is treated as a `RoundTube`.
        threshold: Omit walls smaller than this fraction of the mean wall area from `contacts`; other results do not
            depend on it. Defaults to 0.

    Returns:
        A `Connectivity`.

    Raises:
        ValueError: If a position is not finite, lies outside the domain or coincides with another, or if `threshold` is
            negative or NaN. On domains other than `Tube`, also if a cell encircles the domain or shares a wall with its
            own periodic image, or if many backbones nearly cross.

    >>> four = find_connectivity([[2, 0.5], [2, -0.5], [1.2, 0], [2.8, 0]], Tube(4, 1, 2))
    >>> four
    Connectivity(4 cells: 6 contacts, 1 transition points, 4 scutoids)
    >>> four.transitions.per_cell.tolist(), four.is_end.tolist()
    ([1, 1, 1, 1], [False, False, True, True])
    """
    if not threshold >= 0:
        raise ValueError(f"threshold={threshold} is not at least 0; give a fraction of the mean wall area")
    domain = domain_of(domain, positions)
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
    """Tabulate contacts and transition points per cell (paper, section 4.4).

    Args:
        connectivity: Result of `find_connectivity`.

    Returns:
        Mapping from column name to an array of shape [n]. `neighbors` is the number of neighbors of each cell;
        `apical_basal_neighbors`, `apical_neighbors`, `basal_neighbors` and `internal_neighbors` count neighbors by the
        surfaces that the common wall reaches (both, only the apical, only the basal, neither). `transitions` is the
        number of transition points of the cell, `is_scutoid` whether it is at least 1. `is_ring` is whether the cell
        encircles the lumen, `pieces` its number of connected components. `stretch_anisotropy` is present for domains
        other than `Tube`.

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
    """Average the numbers of contacts and transition points over the cells of a tissue (paper, section 4.4).

    Args:
        connectivity: Result of `find_connectivity`.
        inner_only: Whether to leave out cells that touch an end of the domain. Defaults to False.

    Returns:
        Mapping from name to number; all values are NaN if no cell is left.

        - `neighbors`: mean number of neighbors; `apical_basal_neighbors`, `apical_neighbors`, `basal_neighbors` and
          `internal_neighbors`: the same by the surfaces that the common wall reaches.
        - `transitions`, `transitions_max`: mean and maximum number of transition points (points where four cells
          meet) per cell.
        - `apical_degree`, `basal_degree`: mean number of neighbors on one surface.
        - `scutoid_fraction`: fraction of cells with at least one transition point.
        - `internal_fraction`: fraction of cells with at least one neighbor on neither surface.
        - `ring_fraction`: fraction of cells that encircle the lumen.
        - `detached_fraction`: fraction of cells with more than one connected component.
        - `identity_residual`: mean of `neighbors` - `apical_degree` - `transitions` / 2. It is 0 in a tissue in which
          no cell encircles the lumen and no two cells share two walls, unless walls were left out by a threshold or
          cells touch an end.

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
    areas: ArrayLike,
    surface: str = "apical",
    inner_only: bool = True,
) -> dict[str, np.ndarray]:
    """Group cells by their number of sides, for the laws of Lewis and of Aboav and Weaire.

    The number of sides of a cell on a surface is the number of its neighbors there. m(n) denotes the mean number of
    sides of the neighbors of cells with n sides. These laws are not part of the paper.

    Args:
        connectivity: Result of `find_connectivity`.
        areas: Area of each cell on the surface, in any unit, shape [n].
        surface: Surface on which neighbors are counted: "apical" (the default), "basal", or "all" for neighbors
            anywhere.
        inner_only: Whether to leave out cells that touch an end of the domain, also as neighbors. Defaults to True.

    Returns:
        Mapping from column name to an array with one entry per number of sides, in increasing order: `sides`; `count`
        and `fraction` of the cells; `relative_area`, their mean area divided by the mean area of all cells (Lewis's
        law); `neighbor_sides`, m(n), NaN if there is no neighbor; `sides_times_neighbor_sides`, n m(n) (linear in n by
        the Aboav-Weaire law).

    Raises:
        ValueError: If `surface` is unknown, or if `areas` does not have shape [n].

    >>> four = find_connectivity([[2, 0.5], [2, -0.5], [1.2, 0], [2.8, 0]], Tube(4, 1, 2))
    >>> table = polygon_classes(four, [1, 1, 2, 2], inner_only=False)
    >>> table["sides"].tolist(), table["count"].tolist(), table["neighbor_sides"].round(2).tolist()
    ([2, 3], [2, 2], [3.0, 2.33])
    """
    if surface not in SURFACES:
        raise ValueError(f"surface={surface!r} is unknown; use one of {', '.join(SURFACES)}")
    contacts, sides = connectivity.contacts, connectivity.contacts.degree(*SURFACES[surface])
    size = np.asarray(areas, float)
    if size.shape != sides.shape:
        raise ValueError(f"areas have shape {size.shape}; give one area for each of the {len(sides)} cells")
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


def tissue_graph(connectivity: Connectivity, columns: Mapping[str, np.ndarray] | None = None) -> "nx.Graph":
    """Build the contact graph of a tissue: one node per cell, one edge per contact (paper, section 4.4).

    All attributes are plain Python values, so the graph can be written by `networkx.write_graphml` and similar
    functions.

    Args:
        connectivity: Result of `find_connectivity`.
        columns: Mapping from attribute name to an array of shape [n], one value per cell. Defaults to the output of
            `tabulate_connectivity`.

    Returns:
        Undirected graph with nodes 0 to n - 1. Node attributes are those of `columns`. Edge attributes are `area` of
        the wall, `apical_length` and `basal_length` of its borders on the two surfaces, `kind` ("apical_basal",
        "apical", "basal" or "internal": the surfaces that the wall reaches), and `pieces`, the number of connected
        components of the wall.

    >>> four = find_connectivity([[2, 0.5], [2, -0.5], [1.2, 0], [2.8, 0]], Tube(4, 1, 2))
    >>> graph = tissue_graph(four)
    >>> graph.nodes[0]["neighbors"], graph.edges[0, 1]["kind"]
    (3, 'apical_basal')
    """
    from networkx import Graph  # takes a sixth of a second to import

    contacts, graph = connectivity.contacts, Graph()
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
