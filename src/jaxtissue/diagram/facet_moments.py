"""Integrals over planar facets clipped to a cylinder, as sums over their edges (host, float64).

A facet with unit normal n = (n_x, n_r m), m a unit vector across the axis, has the coordinates
u = p . (axis x m) and v = n_r x - n_x w, with w = p . m. On it x and w depend on v alone, so a cylinder and
the end planes confine u to [-h, h], h = sqrt(R^2 - w^2), and v to an interval. An integral over the clipped
facet is then a sum over its edges, int int g du dv = sum of int (int g du from 0 to clamp(u, -h, h)) dv, well
conditioned for every normal.
"""

from typing import Any, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Float64

Fields = TypeVar("Fields", bound=tuple[Any, ...])


class Edges(NamedTuple):
    """Directed segments by the coordinates of their two ends, see the top of the module."""

    u: Float64[np.ndarray, "2 e"]
    v: Float64[np.ndarray, "2 e"]
    w: Float64[np.ndarray, "2 e"]
    x: Float64[np.ndarray, "2 e"]


class Clip(NamedTuple):
    """The solid cylinder r < radius, |x| < half."""

    radius: float
    half: float


def take(data: Fields, chosen: np.ndarray) -> Fields:
    """The chosen facets or edges (the last axis of every field)."""
    return type(data)(*(field[..., chosen] for field in data))


def at(edges: Edges, share: np.ndarray) -> Edges:
    """Points at the given shares of the way along the edges."""
    return Edges(*(ends[0] + share * (ends[1] - ends[0]) for ends in edges))


def clipped_moments(edges: Edges, clip: Clip) -> Float64[np.ndarray, "6 e"]:
    """The moments swept by edges, u clamped to the disc and v cut at the end planes."""
    cuts = _cuts(edges, clip)
    start, stop = cuts[:-1], cuts[1:]
    u, _, w, x = at(edges, (start + stop) / 2)
    inside = (stop > start) & (np.abs(x) < clip.half) & (np.abs(w) < clip.radius)
    straight = inside & (u * u + w * w <= clip.radius**2)

    def pieces(kind: Bool[np.ndarray, "7 e"]) -> tuple[np.ndarray, Edges]:
        edge = np.nonzero(kind)[1]
        return edge, at(take(edges, edge), np.stack([start[kind], stop[kind]]))

    (line, lines), (arc, arcs) = pieces(straight), pieces(inside & ~straight)
    swept = np.append(straight_moments(lines), _arc_moments(arcs, clip.radius), axis=1)
    return np.stack([np.bincount(np.append(line, arc), row, cuts.shape[1]) for row in swept])


def _cuts(edges: Edges, clip: Clip) -> Float64[np.ndarray, "8 e"]:
    """Shares, sorted from 0 to 1, where an edge meets the end planes, the cylinder, or |w| = radius."""
    (u, _), _, (w, _), (x, _) = edges
    du, _, dw, dx = (ends[1] - ends[0] for ends in edges)
    with np.errstate(divide="ignore", invalid="ignore"):
        square = du * du + dw * dw
        middle = -(u * du + w * dw) / square
        chord = np.sqrt(np.maximum(clip.radius**2 - (u * dw - w * du) ** 2 / square, 0) / square)
        planes = [(s * clip.half - x) / dx for s in (-1, 1)] + [(s * clip.radius - w) / dw for s in (-1, 1)]
    cuts = np.stack([np.zeros_like(u), np.ones_like(u), middle - chord, middle + chord, *planes])
    return np.sort(np.clip(np.nan_to_num(cuts), 0, 1), axis=0)


def _powers(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The integrals of (1, v, u, v^2, u v, u^2) du from 0 to u."""
    return np.stack([u, u * v, u * u / 2, u * v * v, u * u * v / 2, u * u * u / 3])


def _gauss(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights on [0, 1], as columns."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return (nodes[:, None] + 1) / 2, weights[:, None] / 2


def straight_moments(edges: Edges) -> Float64[np.ndarray, "6 e"]:
    """Moments swept by whole edges; the integrand is cubic along the edge, so two Gauss nodes are exact."""
    first, second = (_powers(*at(edges, node)[:2]) for node in _gauss(2)[0])
    return (first + second) * (edges.v[1] - edges.v[0]) / 2


def _arc_moments(edges: Edges, radius: float) -> Float64[np.ndarray, "6 e"]:
    """Moments swept by edges clamped to u = +-h(v), with Gauss nodes in the angle f of w = radius sin f."""
    nodes, weights = _gauss(12)  # roundoff for every arc: they are below 180 degrees
    start, stop = np.arcsin(np.clip(edges.w / radius, -1, 1))
    half = (stop - start) / 2
    angle = start + 2 * nodes * half
    # (sin f - sin f_0) / (sin f_1 - sin f_0) and its derivative, also where w is constant
    scale = np.cos((start + stop) / 2) * np.sinc(half / np.pi)
    share = nodes * np.cos((angle + start) / 2) * np.sinc(nodes * half / np.pi) / scale
    weights = weights * np.cos(angle) / scale * (edges.v[1] - edges.v[0])
    u = np.sign(edges.u.sum(axis=0)) * radius * np.cos(angle)
    return np.sum(weights * _powers(u, at(edges, share).v), axis=1)
