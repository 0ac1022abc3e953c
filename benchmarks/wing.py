"""The contacts of a fly's wing layer by layer: bent backbones through measured centers against measured contacts.

    python benchmarks/wing.py FOLDER [--pixel 0.06] [--nodes 2 3 5 0] [--layers 10] [--out FILE]

FOLDER holds `wing_1_cells.csv.gz` (layer, cell, x, y, area; pixels of an image of 512 x 512, layers 0.5 um apart) and
`wing_1_contacts.csv.gz` (layer, two cells, shares of their perimeters), and those of wing 3. The size of a pixel is not
in the data: cells of 1.5 to 3 um are usual there. So many nodes are taken from as many layers, 0 for all, and contacts
are compared on so many layers. Inner cells are those with neighbors all round on every layer.
"""

import gzip
from pathlib import Path
from typing import Any

import common
import numpy as np
from scipy.spatial import Voronoi

import jaxtissue as jt
from jaxtissue.geometry.domain_positions import as_domain_positions
from jaxtissue.neighbors.section_lists import find_sections
from jaxtissue.sections.cells import RULE, Layers
from jaxtissue.sections.contacts import layer_contacts

IMAGE, GAP = 512.0, 0.5  # pixels, um
LEAST = 0.02  # of a perimeter: what is shorter is no contact
FULL = 0.97  # of a perimeter that contacts with cells must make up for inner cells


def read(path: Path) -> np.ndarray:
    """The numbers of a table."""
    with gzip.open(path, "rt") as file:
        return np.loadtxt(file, delimiter=",", skiprows=1)


def measured(folder: Path, wing: int) -> tuple[np.ndarray, np.ndarray]:
    """The centers of the cells, [layers, n, 2], and the shares of their perimeters, [layers, n, n]."""
    cells, contacts = (read(folder / f"wing_{wing}_{what}.csv.gz") for what in ("cells", "contacts"))
    layer, cell = cells[:, :2].astype(int).T
    centers = np.zeros((layer.max() + 1, cell.max() + 1, 2))
    centers[layer, cell] = cells[:, 2:4]
    is_there = centers.any(axis=2)  # 0, 0 where a cell is not seen
    some = np.flatnonzero(is_there.any(axis=0))
    for k, seen in zip(some, is_there.T[some], strict=True):
        for axis in (0, 1):
            centers[:, k, axis] = np.interp(np.arange(len(seen)), np.flatnonzero(seen), centers[seen, k, axis])
    share = np.zeros((*centers.shape[:2], centers.shape[1]))
    layer, a, b = contacts[:, :3].astype(int).T
    share[layer, b, a], share[layer, a, b] = contacts[:, 3:].T
    return centers[:, some], share[:, some][:, :, some]


def by_sections(centers: np.ndarray, nodes: int, pixel: float, shown: np.ndarray) -> np.ndarray:
    """The shares of perimeters of the cells of bent backbones, on the layers that are shown."""
    layers, n = centers.shape[:2]
    unit = IMAGE / np.sqrt(n)
    slab = jt.Slab(IMAGE / unit, IMAGE / unit, (layers - 1) * GAP / pixel / unit)
    taken = np.round(np.linspace(0, layers - 1, nodes or layers)).astype(int)
    height = np.broadcast_to(taken / (layers - 1), (n, len(taken)))[..., None]
    place = np.concatenate([centers[taken].transpose(1, 0, 2) / unit, height], axis=2)
    heights = np.append(shown / (layers - 1), [0.0, 1.0])
    plan = Layers(heights, np.ones((1, len(heights))))
    found = find_sections(slab, as_domain_positions(place, slab, bent=True), plan, RULE)
    contacts = layer_contacts(found.sections, found.lists)
    length = np.zeros((len(heights), n, n))
    length[contacts.layer, *contacts.pairs.T] = contacts.length
    length += length.transpose(0, 2, 1)
    print(f"  unproved corners {found.unproved}, cut cells {int(np.asarray(found.sizes.is_cut).sum())}", flush=True)
    return (length / np.maximum(length.sum(axis=2, keepdims=True), 1e-12))[:-2]


def of_centers(centers: np.ndarray) -> np.ndarray:
    """The same for the plane diagrams of the centers alone."""
    share = np.zeros((*centers.shape[:2], centers.shape[1]))
    for place, table in zip(centers, share, strict=True):
        mirrored = [
            place,
            place * [-1, 1],
            place * [1, -1],
            [2 * IMAGE, 0] + place * [-1, 1],
            [0, 2 * IMAGE] + place * [1, -1],
        ]
        diagram = Voronoi(np.concatenate(mirrored))
        for (a, b), ends in zip(diagram.ridge_points, diagram.ridge_vertices, strict=True):
            if max(a, b) < len(place) and -1 not in ends:
                table[a, b] = table[b, a] = np.linalg.norm(np.subtract(*diagram.vertices[ends]))
        table /= np.maximum(table.sum(axis=1, keepdims=True), 1e-12)
    return share


def compared(share: np.ndarray, truth: np.ndarray, inner: np.ndarray) -> dict[str, float]:
    """F1 of contacts of inner cells, pooled over layers, and their neighbors on any of the layers."""
    found, true = (np.maximum(table, table.transpose(0, 2, 1)) > LEAST for table in (share, truth))
    chosen = inner[:, None] & inner
    both = (found & true)[:, chosen].sum()
    return {
        "f1": float(2 * both / (found[:, chosen].sum() + true[:, chosen].sum())),
        "neighbors": float(found.any(axis=0)[inner].sum(axis=1).mean()),
        "measured_neighbors": float(true.any(axis=0)[inner].sum(axis=1).mean()),
    }


def main() -> None:
    """Compare both wings."""
    parser = common.options(__doc__ or "", "wing")
    parser.add_argument("folder", type=Path, help="folder of the tables")
    parser.add_argument("--pixel", type=float, default=0.06, help="size of a pixel, um")
    parser.add_argument("--nodes", type=int, nargs="+", default=[2, 3, 5, 0], help="numbers of nodes, 0 for all")
    parser.add_argument("--layers", type=int, default=10, help="layers that are compared")
    given = parser.parse_args()
    results: dict[str, Any] = {"pixel": given.pixel, "layers": given.layers}
    for wing in (1, 3):
        centers, truth = measured(given.folder, wing)
        shown = np.unique(np.round(np.linspace(0, len(centers) - 1, given.layers)).astype(int))
        inner = (truth.sum(axis=2) > FULL).all(axis=0)
        results[f"wing {wing}"] = row = {"cells": centers.shape[1], "inner": int(inner.sum())}
        row["plane"] = compared(of_centers(centers[shown]), truth[shown], inner)
        print(wing, row, flush=True)
        for nodes in given.nodes:
            row[str(nodes or "all")] = compared(by_sections(centers, nodes, given.pixel, shown), truth[shown], inner)
            print(wing, nodes, row[str(nodes or "all")], flush=True)
    common.write(given.out, results)


if __name__ == "__main__":
    main()
