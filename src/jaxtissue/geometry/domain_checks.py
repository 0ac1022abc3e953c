"""Checks of a new domain: its surfaces are finite and apart, and its layers do not overlap."""

from dataclasses import fields
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from scipy.spatial import KDTree

from jaxtissue.compilation.modes import usual_modes
from jaxtissue.geometry.base_surfaces import Rectangle
from jaxtissue.geometry.vectors import Vector, components, rows

LEVELS = (0.0, 0.25, 0.5, 0.75, 1.0)
NODES = 48  # in each direction
SINGULAR = 1e-4  # of the largest volume element
SIGNED = ("amplitude", "basal")  # sizes that may be 0 or less


def check_sizes(domain: Any) -> None:
    """Raise `ValueError` for sizes that are no positive finite numbers."""
    for field in fields(domain):
        value = getattr(domain, field.name)
        if field.name == "arc" and not 0 < value <= 2 * np.pi + 1e-6:
            raise ValueError(f"arc={value} is not an angle in radians above 0 and at most 2 pi; correct it")
        if field.metadata.get("static") or callable(value) or value is None:
            continue
        for leaf in jax.tree.leaves(value):
            if isinstance(leaf, Tracer):
                continue
            size = np.asarray(leaf)
            least = -np.inf if field.name in SIGNED else 0
            if size.dtype.kind not in "iuf" or not (np.isfinite(size).all() and (size > least).all()):
                told = "finite" if field.name in SIGNED else "positive finite"
                raise ValueError(f"{field.name}={value} is not a {told} number; correct it")


@usual_modes()
def check_domain(domain: Any) -> None:
    """Raise `ValueError`, naming the place, unless F maps the base surface and the heights one to one.

    Looked at on a grid: the surfaces are finite, the volume element has one sign, closed and periodic directions
    close, and no two places that are far apart on the base surface come near each other. Traced sizes are not looked
    at.
    """
    if any(isinstance(leaf, Tracer) or np.ndim(leaf) > 1 for leaf in jax.tree.leaves(domain)):
        return
    if any(np.ndim(getattr(domain, field.name, 0)) > (1 if "axes" in field.name else 0) for field in fields(domain)
           if field.name not in ("extent", "periodic", "directions")):  # fmt: skip
        return  # several domains for `vmap`
    points = domain.base.nodes(NODES)[0]
    ends, volume = (np.asarray(part, float) for part in _look(domain, points))
    place = np.stack([np.asarray(part, float) for part in points], axis=1)

    def where(at: int, level: int | None = None) -> str:
        told = ", ".join(f"{name}={value:.4g}" for name, value in zip(domain.columns, place[at], strict=True))
        return told if level is None else f"{told}, h={LEVELS[level]:g}"

    for side, surface in zip(("apical", "basal"), ends, strict=True):
        wrong = np.flatnonzero(~np.isfinite(surface).all(axis=1))
        if len(wrong):
            raise ValueError(
                f"the {side} surface is not finite at {where(wrong[0])}; correct its function or its sizes"
            )
    thickness = np.linalg.norm(ends[1] - ends[0], axis=1)
    size = np.abs(volume).max()
    at = int(thickness.argmin())
    if not thickness[at] > SINGULAR * thickness.max() or not size > 0:
        raise ValueError(f"the surfaces touch at {where(at)}; increase the distance between them")
    signs = np.sign(volume) * np.sign(np.median(volume))
    if not (signs * np.abs(volume) > SINGULAR * size).all():
        level, at = np.unravel_index((signs * np.abs(volume)).argmin(), volume.shape)
        reason = "cross, or the tissue folds over itself (thicker than its radius of curvature, or bent too tightly),"
        raise ValueError(
            f"the surfaces {reason} at {where(int(at), int(level))}; make the tissue thinner or less curved"
        )
    if isinstance(domain.base, Rectangle):
        _check_closure(domain)
    _check_apart(domain, place, ends, where)


@jax.jit
def _look(domain: Any, points: Vector) -> tuple[jax.Array, jax.Array]:
    """Both ends, [2, points, 3], and the volume element, [levels, points]."""
    levels = jnp.array(LEVELS, points[0].dtype)[:, None]
    wide = tuple(jnp.broadcast_to(part, (len(LEVELS), part.shape[0])) for part in points)
    frame = domain.frame(wide, (jnp.zeros_like(wide[0]),) * 2, levels)
    return jnp.stack([rows(surface) for surface in domain.surfaces(points)]), frame.elements()[0]


def _check_closure(domain: Any) -> None:
    """Raise `ValueError` where a closed direction does not close, or a periodic one does not go on as a copy."""
    base = domain.base
    points = np.stack([np.asarray(part, float) for part in base.nodes(5)[0]], axis=1)
    for k, direction in enumerate(base.directions):
        if direction == "free":
            continue
        step = np.zeros(2)
        step[k] = float(base.extent[k])
        here, there = (np.asarray(_ends(domain, jnp.asarray(p, float)), float) for p in (points, points + step))
        shift = there - here
        off = np.abs(shift - (shift[:1, :1] if direction == "periodic" else 0)).max()
        if not off < 1e-3 * np.ptp(here.reshape(-1, 3), axis=0).max():
            told = "return to the same points" if direction == "closed" else "repeat as a shifted copy"
            raise ValueError(f"direction {domain.columns[k]} is {direction}, but the surfaces do not {told} after "
                             f"{step[k]:g}; correct the extent or the functions")  # fmt: skip


@jax.jit
def _ends(domain: Any, points: jax.Array) -> jax.Array:
    return jnp.stack([rows(surface) for surface in domain.surfaces(components(points))])


def _check_apart(domain: Any, place: np.ndarray, ends: np.ndarray, where: Any) -> None:
    """Raise `ValueError` where places far apart on the base surface come nearer than their neighbors on the grid."""
    middle = ends.mean(axis=0)
    tree = KDTree(middle)
    spacing = tree.query(middle, 2)[0][:, 1]
    flat = place
    if isinstance(domain.base, Rectangle):  # on a ring for each direction that is not free
        parts = []
        for k, direction in enumerate(domain.base.directions):
            extent = float(domain.base.extent[k])
            turn = 2 * np.pi * place[:, k] / extent
            parts += [place[:, k] / extent] if direction == "free" else [np.cos(turn) / 6, np.sin(turn) / 6]
        flat = np.stack(parts, axis=1)
    for side, surface in zip(("apical", "basal"), ends, strict=True):
        pairs = np.asarray(tree.query(surface, 1)[1])
        apart = np.linalg.norm(flat - flat[pairs], axis=1)
        near = np.linalg.norm(surface - middle[pairs], axis=1) < np.minimum(
            spacing[pairs], 0.5 * np.linalg.norm(surface - middle, axis=1)
        )
        wrong = np.flatnonzero(near & (apart > 8 / NODES))
        if len(wrong):
            at, other = int(wrong[0]), int(pairs[wrong[0]])
            told = f"the {side} surface at {where(at)} lies inside the tissue at {where(other)}"
            raise ValueError(f"{told}; make the tissue thinner or less curved")
