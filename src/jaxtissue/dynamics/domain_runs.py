"""Spans of sweeps on any domain, each checked against a survey and repeated if the survey shows a missing neighbor."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxtissue.compilation.batching import Batch
from jaxtissue.dynamics.domain_lists import Measured, Shortlists, survey, with_slots
from jaxtissue.dynamics.domain_sweeps import play
from jaxtissue.dynamics.domain_updates import Scene, Surroundings
from jaxtissue.dynamics.independent_sets import padded_orders
from jaxtissue.dynamics.metropolis import draw
from jaxtissue.dynamics.replays import EXACT, SPAN, Segment, energies_together, largest_difference, last_sizes
from jaxtissue.dynamics.spans import Trail
from jaxtissue.dynamics.surface_moves import longest_move
from jaxtissue.energy import Model
from jaxtissue.geometry.nodes import bends_of
from jaxtissue.measurement.quadrature import SECTIONS, Resolution, section_layers
from jaxtissue.neighbors.section_lists import crowd_of
from jaxtissue.sections.cells import MANY_SLOTS, QUICK, RULE, Layers, plan_layers
from jaxtissue.sections.crowd import tell_of_turning, turning_cells

Plan = Sequence[Int[np.ndarray, "rounds width"]]
DEFECT = 2e-3  # of the tissue, by which the volumes of all cells may miss it without a warning


class Played(NamedTuple):
    """A span that was played: its sweeps, the tissue after it, and how far the energy had drifted from that."""

    sweep: int  # the number of sweeps done
    trail: Trail
    measured: Measured
    drift: float


@dataclass
class DomainRun:
    """What a run on a domain keeps.

    Attributes:
        model: The energy, in the precision of JAX.
        seed: The seed of the moves.
        temperatures: T of each sweep of the run.
        layers: On how many layers cells are measured.
        scene: What sweeps are played with, without lists; of straight backbones.
    """

    model: Model
    seed: int
    temperatures: Float[np.ndarray, "sweeps"]
    layers: int
    scene: Scene
    _warned: bool = False

    def survey(self, positions: Float[np.ndarray, "n *k d"], batch: Batch) -> Measured:
        """Measure a tissue on complete lists; warns, once, of cells that cannot be trusted."""
        measured = survey(positions, self._scene(positions), batch)
        cut = int(measured.is_cut.sum())
        doubts = self._doubts(measured)
        if cut or measured.unproved:
            told = (
                f"{cut} cells are too wide to be measured, and neighbors may be missing at {measured.unproved} corners"
            )
            doubts.append(f"{told}; energies may be wrong: use more cells")
        if doubts and not self._warned:
            self._warned = True
            warnings.warn("; ".join(doubts), stacklevel=4)
        return measured

    def _scene(self, positions: Float[np.ndarray, "n *k d"]) -> Scene:
        """The scene with layers between the heights at which backbones bend."""
        bends = bends_of(positions, self.scene.domain)
        return self.scene if bends is None else replace(self.scene, layers=run_layers(self.model, self.layers, bends))

    def _doubts(self, measured: Measured) -> list[str]:
        """What else tells that cells cannot be trusted: volumes add up to the tissue if they can."""
        doubts, whole = [], float(self.model.domain.volume)
        off = abs(float(np.asarray(measured.state.cells.sizes.volume, float).sum()) / whole - 1)
        if measured.positions.ndim == 3:
            crowd = crowd_of(self.scene.domain, measured.positions)
            if len(cells := turning_cells(crowd, *measured.walls())):
                doubts.append(tell_of_turning(cells))
        if off > DEFECT:
            doubts.append(f"volumes add up to {100 * off:.2g} % more or less than the tissue; energies may be wrong")
        return doubts

    def play(self, measured: Measured, plan: Plan, sweep: int, batch: Batch) -> Played:
        """Play sweeps from number `sweep` on, given their rounds; in parts, where lists turn out to lack a neighbor."""
        span, lists = [Segment(plan)], Shortlists(measured)
        trails, drift, unfinished = [], 0.0, None
        while span:
            segment = span[0]
            trail, measured = self._attempt(measured, lists.surroundings(), segment.plan, sweep, batch)
            after = again = self.survey(np.asarray(trail.positions[-1]), batch)
            if not self._agree(after, trail):
                again = survey(np.asarray(trail.positions[-1]), self._scene(measured.positions), batch, lists.rivals)
            if not self._agree(again, trail):
                if len(pairs := lists.lacking(again)):
                    lists.add(pairs)
                    measured = survey(measured.positions, self._scene(measured.positions), batch, lists.rivals)
                    continue
                if parts := halves(segment):
                    span[:1], lists = parts, Shortlists(measured)
                    continue
            span.pop(0)
            drift = max(drift, self._drift(after, trail, batch))
            if unfinished is not None:
                trail = trail._replace(info=jax.tree.map(np.add, unfinished, trail.info))
            unfinished = None if segment.is_whole else trail.info
            if segment.is_whole:
                trails.append(trail)
                sweep += len(segment.plan)
            measured, lists = after, Shortlists(after)
        return Played(sweep, jax.tree.map(lambda *leaves: np.concatenate(leaves), *trails), measured, drift)

    def _attempt(
        self, measured: Measured, near: Surroundings, plan: Plan, sweep: int, batch: Batch
    ) -> tuple[Trail, Measured]:
        """Play sweeps on these lists; also the tissue before them, anew if it has to have more slots."""
        positions = measured.positions
        n, kinds, dtype = len(positions), positions.ndim + 1, positions.dtype  # with nodes, that of each move is drawn
        temperatures, draws = np.zeros(SPAN, dtype), np.zeros((SPAN, kinds, n), dtype)
        temperatures[: len(plan)] = self.temperatures[sweep : sweep + len(plan)]
        for k in range(len(plan)):
            draws[k] = draw(self.seed, sweep + k, n, dtype, kinds)
        scene, orders = replace(self._scene(positions), near=near, rule=measured.rule), padded_orders(plan, SPAN, near)
        call = draws, measured.relisted(np.asarray(near.rivals)), scene, temperatures, orders
        ((trail, lacks_slots),) = batch.run(play, [call])
        if lacks_slots.any() and measured.rule.slots < MANY_SLOTS:
            wider = survey(positions, with_slots(scene), batch)
            return self._attempt(wider, near, plan, sweep, batch)
        trail = trail._replace(positions=trail.positions[..., : positions.shape[-1]])  # heights if these have them
        return jax.tree.map(lambda leaf: leaf[: len(plan)], trail), measured

    def _agree(self, after: Measured, trail: Trail) -> bool:
        """Whether the sizes that were carried along are those measured anew, to rounding."""
        rounding = EXACT * float(np.finfo(trail.positions.dtype).eps) * float(self.model.mean_volume)
        return bool(largest_difference(after.sizes, last_sizes(trail)).max() <= rounding)

    def _drift(self, after: Measured, trail: Trail, batch: Batch) -> float:
        sizes = [after.sizes, last_sizes(trail)]
        first, second = (table[0, 0].item() for table in energies_together([self.model] * 2, sizes, batch))
        return abs(first - second) / max(abs(first), abs(second), 1e-300)


def domain_run(
    model: Model, resolution: Resolution | str, seed: int, temperatures: Float[np.ndarray, "sweeps"]
) -> DomainRun:
    """A run with a model that has the precision of JAX."""
    count = section_layers(resolution)
    cells = max(1, round(float(model.domain.volume) / float(model.mean_volume)))
    nothing = Surroundings(*[np.zeros((cells, 1), np.int32)] * 4)
    longest = np.asarray(longest_move(model.domain, cells), jnp.result_type(float))  # type: ignore[arg-type]
    rule = QUICK if count <= SECTIONS["draft"] else RULE
    return DomainRun(model, seed, temperatures, count, Scene(model, nothing, run_layers(model, count), longest, rule))


def run_layers(model: Model, count: int, bends: Float[Array | np.ndarray, " k"] | None = None) -> Layers:
    """The layers on which a run measures cells: with the surfaces only if the energy depends on them."""
    layers = plan_layers(count, False, bends)
    return layers if model.has_surfaces else Layers(layers.heights[:-2], layers.weights[:, :-2])


def halves(segment: Segment) -> list[Segment]:
    """The first and second half of a segment's sweeps, rounds or moves; none of a single move."""
    if parts := segment.halves():
        return parts
    movers = segment.plan[0][0]
    movers = movers[movers >= 0]
    if len(movers) < 2:
        return []
    parts = []
    for some in np.array_split(movers, 2):
        row = np.full((1, segment.plan[0].shape[1]), -1, np.int32)
        row[0, : len(some)] = some
        parts.append(row)
    return [Segment([parts[0]], False), Segment([parts[1]], segment.is_whole)]
