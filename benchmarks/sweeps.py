"""Compile time and seconds a sweep at n = 500, and the energy by `draft` and by `fine` along each run."""

import resource
import statistics
import time

import common
import jax
import jax.numpy as jnp
from matplotlib.figure import Figure

import jaxtissue as jt
from jaxtissue.compilation.batching import PROGRAMS
from jaxtissue.dynamics.replays import SPAN

SWEEPS = 100
LOOKS = (0, 1, 2, 5, 10, 20, 30, 50, 75, 100)


def run(apical_radius: float) -> dict:
    """One paper tube annealed by the draft estimator, looked at by the fine one."""
    jt.use_cores(1)
    tube = jt.Tube(100, apical_radius, 10)
    model = jt.tube_model(tube, 500)
    initial = tube.random_positions(jax.random.key(0), 500)
    begin = time.perf_counter()
    annealer = jt.Annealer(model, jt.PRESETS["draft"], "is-mh", 0, jt.constant_schedule(2.0, SWEEPS))
    state = annealer.start(initial)
    records, looks = [annealer.record(state)], {0: state.positions}
    first, programs = None, 0
    while state.sweep < SWEEPS:
        state, rows, trail = annealer.advance(state)
        records += rows
        looks |= {row.sweep: places for row, places in zip(rows, trail, strict=True) if row.sweep in LOOKS}
        if first is None:
            first, programs = time.perf_counter() - begin, len(PROGRAMS)
    fine = {}
    for sweep, positions in looks.items():
        cells = jt.measure_tissue(jnp.asarray(positions), tube, jt.PRESETS["fine"], refine=False)
        fine[sweep] = float(jt.epithelial_energy(cells, model).sum())
    seconds = [record.seconds for record in records[1 + 2 * SPAN :]]
    return {
        "compile_and_first_span_seconds": first,
        "seconds_per_sweep": statistics.median(seconds),
        "seconds_per_sweep_max": max(seconds),
        "compiled_after_first_span": len(PROGRAMS) - programs,
        "rounds": statistics.mean(record.rounds for record in records[1:]),
        "collisions_per_move": sum(record.collisions for record in records) / (500 * SWEEPS),
        "left_cell_per_move": sum(record.left_cell for record in records) / (500 * SWEEPS),
        "largest_drift": max(record.drift for record in records),
        "draft_energy": [record.energy for record in records],
        "fine_energy": fine,
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def draw(runs: dict[str, dict]) -> Figure:
    """Both energies along each run."""
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.subplots()
    for color, (name, result) in zip(("#0072B2", "#D55E00"), runs.items(), strict=True):
        axes.plot(result["draft_energy"], color=color, label=f"$R_a$ = {name}, draft (accepts the moves)")
        fine = result["fine_energy"]
        axes.plot(list(fine), list(fine.values()), "o", mfc="none", color=color, label=f"$R_a$ = {name}, fine")
    axes.set(
        xlabel="sweep",
        ylabel="tissue energy",
        yscale="log",
        title="Moves judged by draft lower the fine energy",
    )
    axes.legend()
    return figure


def main() -> None:
    """Run both tubes, print the figures, write JSON and picture."""
    path = common.output(__doc__ or "", "sweeps")
    runs = {f"{radius:g}": run(radius) for radius in (1.0, 5.0)}
    for name, result in runs.items():
        print(f"R_a = {name}")
        for key, value in result.items():
            if not isinstance(value, list | dict):
                print(f"  {key:34} {value:.6g}")
        fine = result["fine_energy"]
        print(f"  fine energy {fine[0]:.0f} -> {fine[SWEEPS]:.0f}: {fine[SWEEPS] / fine[0]:.1%}")
    common.write(path, {"runs": runs})
    draw(runs).savefig(path.with_suffix(".png"), dpi=120)


if __name__ == "__main__":
    main()
