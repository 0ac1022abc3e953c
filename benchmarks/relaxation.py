"""Relaxation by the gradient against Metropolis: energies over seconds from one random start.

    python benchmarks/relaxation.py [--cells 500] [--sweeps 1000] [--steps 40]

Writes benchmarks/results/relaxation.json. Compiling is apart: each method runs once before it is timed.
"""

import time

import common
import jax
import numpy as np

import jaxtissue as jt


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
        for method in ("lbfgs", "fire"):
            jt.relax(place, model, method, steps=2)
            found = jt.relax(place, model, method, steps=options.steps)
            curve = [(record.seconds, record.energy) for record in found.history]
            reached = next((seconds for seconds, energy in curve if energy <= target[1]), None)
            row = {"apical_radius": inner, "method": method, "curve": curve, "message": found.message}
            row |= {"evaluations": found.history[-1].evaluations, "seconds_to_energy_of_sweeps": reached}
            rows.append(row | {"sooner": target[0] / reached if reached else None})
        for row in rows[-4:]:
            print(inner, row["method"], [f"{value:.6g}" for value in row["curve"][-1]], row.get("sooner"), flush=True)
    sizes = {name: getattr(options, name) for name in ("cells", "sweeps", "steps")}
    common.write(options.out, sizes | {"rows": rows})


if __name__ == "__main__":
    main()
