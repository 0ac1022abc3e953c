"""Parallel tempering against single chains: means in equilibrium, and effective samples a second.

    python benchmarks/tempering.py [--cells 30] [--sweeps 20000]

Each method samples the same small tissue at T = 2: Metropolis with one move at a time and with independent moves
together, and tempering. Means of energy, volume variance and neighbors come with standard errors by the time in which
they forget; so do effective samples a second. Writes benchmarks/results/tempering.json.
"""

import time
from collections.abc import Callable
from typing import Any

import common
import jax
import numpy as np

import jaxtissue as jt

TEMPERATURES = 2.0 * 1.4 ** np.arange(4)
EVERY = 20  # sweeps between two looks at cells and contacts


def forgetting(series: np.ndarray) -> float:
    """The integrated autocorrelation time, in rows, by Sokal's window of five times itself."""
    off = series - series.mean()
    power = np.abs(np.fft.rfft(off, 2 * len(off))) ** 2
    correlation = np.fft.irfft(power)[: len(off)]
    times = 2 * np.cumsum(correlation / correlation[0]) - 1
    window = np.arange(len(times)) >= 5 * times
    return float(max(times[window.argmax()] if window.any() else times[-1], 1.0))


def told(series: np.ndarray, seconds: float) -> dict[str, float]:
    """Mean, standard error and effective samples a second of what was found in so many seconds."""
    series = np.asarray(series, float)[len(series) // 10 :]  # the rest is its way down
    rows = forgetting(series)
    effective = len(series) / rows
    return {
        "mean": float(series.mean()),
        "error": float(series.std() / effective**0.5),
        "forgotten_in": rows,
        "effective_a_second": effective / (0.9 * seconds),
    }


class Looks:
    """Looks at the coldest tissue now and then."""

    def __init__(self, tube: jt.Tube) -> None:
        self.tube, self.sweep, self.seconds = tube, 0, 0.0
        self.variance: list[float] = []
        self.neighbors: list[float] = []

    def __call__(self, positions: np.ndarray) -> None:
        self.sweep += 1
        if self.sweep % EVERY == 0:
            begin = time.perf_counter()
            self.variance.append(float(np.var(jt.measure_tissue(positions, self.tube, "draft", refine=False).volume)))
            self.neighbors.append(2 * len(jt.find_contacts(positions, self.tube).pairs) / len(positions))
            self.seconds += time.perf_counter() - begin


def run(name: str, sample: Callable[[int, Looks], np.ndarray], tube: jt.Tube, sweeps: int) -> dict[str, Any]:
    """A method's row, after a short run that compiles."""
    sample(40, Looks(tube))
    looks, begin = Looks(tube), time.perf_counter()
    energies = sample(sweeps, looks)
    seconds = time.perf_counter() - begin - looks.seconds
    row = {"method": name, "seconds": seconds, "energy": told(energies[1:], seconds)}
    row |= {"volume_variance": told(looks.variance, seconds), "neighbors": told(looks.neighbors, seconds)}
    print(row, flush=True)
    return row


def main() -> None:
    """Run all methods, and write the table."""
    parser = common.options((__doc__ or "").split("\n")[0], "tempering")
    parser.add_argument("--cells", type=int, default=30)
    parser.add_argument("--sweeps", type=int, default=20000)
    options = parser.parse_args()
    tube = jt.Tube(options.cells / 5, 2.0, 5.0)
    start, model = tube.random_positions(jax.random.key(0), options.cells), jt.tube_model(tube, options.cells)

    def single(algorithm: str, sweeps: int, looks: Looks) -> np.ndarray:
        annealer = jt.Annealer(model, "draft", algorithm, 0, np.full(sweeps, TEMPERATURES[0]))
        state = annealer.start(start)
        energies = [annealer.record(state).energy]
        while state.sweep < sweeps:
            state, records, trail = annealer.advance(state)
            energies += [record.energy for record in records]
            for positions in trail:
                looks(positions)
        return np.array(energies)

    def tempered(sweeps: int, looks: Looks) -> np.ndarray:
        found = jt.temper(start, model, TEMPERATURES, sweeps, callback=lambda _, positions: looks(positions[0]))
        print(found)
        return found.energies[:, 0]

    rows = [run(name, lambda *how, name=name: single(name, *how), tube, options.sweeps) for name in ("mh", "is-mh")]
    rows.append(run("tempering", tempered, tube, options.sweeps))
    sizes = {"cells": options.cells, "sweeps": options.sweeps, "temperatures": TEMPERATURES.tolist()}
    common.write(options.out, sizes | {"rows": rows})


if __name__ == "__main__":
    main()
