"""Relaxation by the gradient against Metropolis: energies over seconds from one random start.

    python benchmarks/relaxation.py [--cells 500] [--sweeps 1000] [--steps 40]

Writes benchmarks/results/relaxation.json. Compiling is apart: each method runs once before it is timed.
"""

import time

import common
import jax
import numpy as np

import jaxtissue as jt

# one after another, with the most steps of all but the last
METHODS: tuple[dict[str, int], ...] = ({"lbfgs": 0}, {"fire": 0}, {"lloyd": 0}, {"lloyd": 5, "lbfgs": 0})


def metropolis(place: np.ndarray, tube: jt.Tube, temperature: float, sweeps: int) -> list[tuple[float, float]]:
    """Seconds and energy after every span of sweeps."""
    model = jt.tube_model(tube, len(place))
    annealer = jt.Annealer(model, "draft", "is-mh", 0, np.full(sweeps, temperature))
    state = annealer.start(place)
    curve, seconds = [(0.0, annealer.record(state).energy)], 0.0
    while state.sweep < sweeps:
        begin, compiled = time.perf_counter(), annealer.compile_seconds
        state, records, _ = annealer.advance(state)
        seconds += time.perf_counter() - begin - (annealer.compile_seconds - compiled)
        curve.append((seconds, records[-1].energy))
    return curve


def relaxed(place: np.ndarray, model: jt.Model, methods: dict[str, int]) -> tuple[list[tuple[float, float]], int, str]:
    """Seconds and energy after every step, by methods one after another, each with its most steps; evaluations."""
    curve, evaluations, message = [], 0, ""
    for method, steps in methods.items():
        found = jt.relax(place, model, method, steps=steps)
        before = curve[-1][0] if curve else 0.0
        curve += [(before + record.seconds, record.energy) for record in found.history]
        place, message = found.positions, found.message
        evaluations += found.history[-1].evaluations
    return curve, evaluations, message


def main() -> None:
    """Run all methods on the paper's tubes, and write the table."""
    parser = common.options((__doc__ or "").split("\n")[0], "relaxation")
    parser.add_argument("--cells", type=int, default=500)
    parser.add_argument("--sweeps", type=int, default=1000)
    parser.add_argument("--steps", type=int, default=40)
    options = parser.parse_args()
    rows = []
    for inner in (1.0, 5.0):
        tube = jt.Tube(options.cells / 5, inner, 10.0)
        place = np.asarray(tube.random_positions(jax.random.key(0), options.cells))
        model = jt.tube_model(tube, options.cells)
        for temperature in (2.0, 0.0):
            metropolis(place, tube, temperature, 20)
            curve = metropolis(place, tube, temperature, options.sweeps)
            rows.append({"apical_radius": inner, "method": f"is-mh, T = {temperature:g}", "curve": curve})
        target = rows[-2]["curve"][-1]
        for methods in METHODS:
            relaxed(place, model, dict.fromkeys(methods, 2))
            curve, evaluations, message = relaxed(place, model, methods | {list(methods)[-1]: options.steps})
            reached = next((seconds for seconds, energy in curve if energy <= target[1]), None)
            row = {"apical_radius": inner, "method": " + ".join(methods), "curve": curve, "message": message}
            row |= {"evaluations": evaluations, "seconds_to_energy_of_sweeps": reached}
            rows.append(row | {"sooner": target[0] / reached if reached else None})
        for row in rows[-2 - len(METHODS) :]:
            print(inner, row["method"], [f"{value:.6g}" for value in row["curve"][-1]], row.get("sooner"), flush=True)
    sizes = {name: getattr(options, name) for name in ("cells", "sweeps", "steps")}
    common.write(options.out, sizes | {"rows": rows})


if __name__ == "__main__":
    main()
