"""The contacts of a fly's wing layer by layer: bent backbones through measured centers against measured contacts.

    python benchmarks/wing.py FOLDER [--pixel 0.03 0.06 0.12] [--nodes 2 3 5 0] [--out FILE]

FOLDER holds `wing_1_cells.csv.gz` (layer, cell, x, y, area; pixels of an image of 512 x 512, layers 0.5 um apart) and
`wing_1_contacts.csv.gz` (layer, two cells, shares of their perimeters), and those of wing 3. The size of a pixel is not
in the data: cells of 1.5 to 3 um are usual there. So many nodes are taken from as many layers, 0 for all. All layers
are compared.

Inner cells touch the border of the image on no layer: their centers are farther from it than the radius of a disk of
their area. The others are cut off: neighbors of theirs are not seen, and their centers are those of the part that is.
"""

import gzip
from pathlib import Path
from typing import Any, NamedTuple

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
AT_ONCE = 15  # layers whose sections are made together: more need more memory
LASTING = 1, 2, 3, 5  # layers on which neighbors are to touch at least


class Wing(NamedTuple):
    """What was measured."""

    centers: np.ndarray  # [layers, n, 2]
    share: np.ndarray  # of the perimeter of each cell, [layers, n, n]
    seen: np.ndarray  # whether a cell is seen on a layer, [layers, n]
    inner: np.ndarray  # [n]


def read(path: Path) -> np.ndarray:
    """The numbers of a table."""
    with gzip.open(path, "rt") as file:
        return np.loadtxt(file, delimiter=",", skiprows=1)


def measured(folder: Path, wing: int) -> Wing:
    """The cells that are seen on any layer; on others they keep the place of the nearest one."""
    cells, contacts = (read(folder / f"wing_{wing}_{what}.csv.gz") for what in ("cells", "contacts"))
    layer, cell = cells[:, :2].astype(int).T
    shape = layer.max() + 1, cell.max() + 1
    centers, area, share = np.zeros((*shape, 2)), np.zeros(shape), np.zeros((*shape, shape[1]))
    centers[layer, cell], area[layer, cell] = cells[:, 2:4], cells[:, 4]
    layer, a, b = contacts[:, :3].astype(int).T
    share[layer, b, a], share[layer, a, b] = contacts[:, 3:].T
    seen = area > 0
    some = np.flatnonzero(seen.any(axis=0))
    for k in some:
        for axis in (0, 1):
            there = np.flatnonzero(seen[:, k])
            centers[:, k, axis] = np.interp(np.arange(len(seen)), there, centers[there, k, axis])
    room = np.minimum(centers, IMAGE - centers).min(axis=2)
    inner = (seen & (room > np.sqrt(area / np.pi))).all(axis=0)
    return Wing(centers[:, some], share[:, some][:, :, some], seen[:, some], inner[some])


def by_sections(centers: np.ndarray, nodes: int, pixel: float) -> np.ndarray:
    """The shares of perimeters of the cells of bent backbones on all layers."""
    layers, n = centers.shape[:2]
    unit = IMAGE / np.sqrt(n)
    slab = jt.Slab(IMAGE / unit, IMAGE / unit, (layers - 1) * GAP / pixel / unit)
    taken = np.round(np.linspace(0, layers - 1, nodes or layers)).astype(int)
    height = np.broadcast_to(taken / (layers - 1), (n, len(taken)))[..., None]
    place = np.concatenate([centers[taken].transpose(1, 0, 2) / unit, height], axis=2)
    backbones, shares = as_domain_positions(place, slab, bent=True), []
    for first in range(0, layers, AT_ONCE):
        heights = np.minimum(np.arange(first, first + AT_ONCE) / (layers - 1), 1)
        plan = Layers(np.append(heights, [0.0, 1.0]), np.ones((1, AT_ONCE + 2)))
        found = find_sections(slab, backbones, plan, RULE)
        contacts, length = layer_contacts(found.sections, found.lists), np.zeros((AT_ONCE + 2, n, n))
        length[contacts.layer, *contacts.pairs.T] = contacts.length
        length += length.transpose(0, 2, 1)
        shares.append((length / np.maximum(length.sum(axis=2, keepdims=True), 1e-12))[:-2])
        lacking = found.unproved, int(np.asarray(found.sizes.is_cut).sum())
        if any(lacking):
            print(f"  layers from {first}: unproved corners {lacking[0]}, cut cells {lacking[1]}", flush=True)
    return np.concatenate(shares)[:layers]


def of_centers(centers: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """The same for the plane diagrams of the centers alone, of the cells that are seen."""
    share = np.zeros((*centers.shape[:2], centers.shape[1]))
    for place, there, table in zip(centers, map(np.flatnonzero, seen), share, strict=True):
        place = place[there]
        mirrored = [
            place,
            place * [-1, 1],
            place * [1, -1],
            [2 * IMAGE, 0] + place * [-1, 1],
            [0, 2 * IMAGE] + place * [1, -1],
        ]
        diagram = Voronoi(np.concatenate(mirrored))
        for pair, ends in zip(diagram.ridge_points, diagram.ridge_vertices, strict=True):
            if max(pair) < len(place) and -1 not in ends:
                a, b = there[pair]
                table[a, b] = table[b, a] = np.linalg.norm(np.subtract(*diagram.vertices[ends]))
        table /= np.maximum(table.sum(axis=1, keepdims=True), 1e-12)
    return share


def contacts_of(share: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Which cells touch on each layer, of those that are seen there."""
    return (np.maximum(share, share.transpose(0, 2, 1)) > LEAST) & seen[:, :, None] & seen[:, None]


def lasting(touching: np.ndarray, inner: np.ndarray) -> list[float]:
    """The mean numbers of neighbors of inner cells on at least so many layers."""
    layers = touching.sum(axis=0)[inner]
    return [float((layers >= least).sum(axis=1).mean()) for least in LASTING]


def compared(share: np.ndarray, wing: Wing) -> dict[str, Any]:
    """F1 of contacts, pooled over layers, and the neighbors of inner cells."""
    found, true, inner = contacts_of(share, wing.seen), contacts_of(wing.share, wing.seen), wing.inner

    def score(chosen: np.ndarray) -> float:
        return float(2 * (found & true)[:, chosen].sum() / (found[:, chosen].sum() + true[:, chosen].sum()))

    layers, missing = true.sum(axis=0)[inner], ~found.any(axis=0)[inner]
    return {
        "f1_of_pairs_of_inner_cells": score(inner[:, None] & inner),
        "f1_of_all_contacts_of_inner_cells": score(np.broadcast_to(inner[:, None], true.shape[1:])),
        "neighbors": lasting(found, inner),
        "missing": float((missing & (layers > 0)).sum() / inner.sum()),
        "missing_of_at_most_5_layers": float((missing & (layers > 0) & (layers <= 5)).sum() / inner.sum()),
    }


def main() -> None:
    """Compare both wings."""
    parser = common.options(__doc__ or "", "wing")
    parser.add_argument("folder", type=Path, help="folder of the tables")
    parser.add_argument("--pixel", type=float, nargs="+", default=[0.03, 0.06, 0.12], help="sizes of a pixel, um")
    parser.add_argument("--nodes", type=int, nargs="+", default=[2, 3, 5, 0], help="numbers of nodes, 0 for all")
    given = parser.parse_args()
    results: dict[str, Any] = {"neighbors_on_at_least": LASTING}
    for number in (1, 3):
        wing = measured(given.folder, number)
        results[f"wing {number}"] = row = {
            "layers": len(wing.centers),
            "cells": len(wing.inner),
            "inner": int(wing.inner.sum()),
            "measured_neighbors": lasting(contacts_of(wing.share, wing.seen), wing.inner),
            "plane": compared(of_centers(wing.centers, wing.seen), wing),
        }
        print(number, row, flush=True)
        for pixel in given.pixel:
            for nodes in given.nodes:
                name = f"pixel {pixel:g}, {nodes or 'all'} nodes"
                row[name] = compared(by_sections(wing.centers, nodes, pixel), wing)
                print(number, name, row[name], flush=True)
    common.write(given.out, results)


if __name__ == "__main__":
    main()
