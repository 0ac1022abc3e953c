"""Samplers in equilibrium: Metropolis, tempering and Langevin moves: the same means, and effective samples a second.

    python benchmarks/samplers.py [--cells 30] [--temperature 2] [--minutes 1.5] [--methods mh is-mh tempering langevin]

Each method samples the same small tissue for as many minutes of the processor: Metropolis with one move at a time and
with independent moves together, tempering, and Langevin moves. Means of energy, volume variance and neighbors come with
standard errors by the time in which they forget, and with their distance from the first method's in such errors; so do
effective samples a second of the processor. Writes benchmarks/results/samplers.json. Pin it: `taskset -c 0`.
"""

import os
import time
from collections.abc import Callable
from typing import Any

import common
import jax
import numpy as np

import jaxtissue as jt

EVERY = 20  # sweeps, or moves of the whole tissue, between two looks at cells and contacts
LATER = 25  # looks until contacts are compared with those of a look
LADDER = 1.4 ** np.arange(4)  # temperatures of the replicas, over that of interest
QUANTITIES = ("energy", "volume_variance", "neighbors")


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
    """Looks at the tissue now and then, for so many seconds beside what the looks take."""

    def __init__(self, tube: jt.Tube, most: float) -> None:
        self.tube, self.most, self.moves, self.looking = tube, most, 0, 0.0
        self.variance: list[float] = []
        self.neighbors: list[float] = []
        self.contacts: list[np.ndarray] = []
        self._begin = time.process_time()

    def __call__(self, positions: np.ndarray) -> bool:
        """Look, and tell whether time is up."""
        self.moves += 1
        if self.moves % EVERY == 0:
            begin = time.process_time()
            self.variance.append(float(np.var(jt.measure_tissue(positions, self.tube, "draft", refine=False).volume)))
            pairs = jt.find_contacts(positions, self.tube).pairs
            self.neighbors.append(2 * len(pairs) / len(positions))
            self.contacts.append(pairs @ [len(positions), 1])
            self.looking += time.process_time() - begin
        return self.seconds() > self.most

    def seconds(self) -> float:
        """What the sampler has taken."""
        return time.process_time() - self._begin - self.looking

    def kept(self) -> float:
        """The share of the contacts of a look that are still there LATER looks on."""
        known = self.contacts[len(self.contacts) // 10 :]
        return float(np.mean([np.isin(one, two).mean() for one, two in zip(known, known[LATER:], strict=False)]))


Sampler = Callable[[Looks], np.ndarray]


def run(name: str, sample: Sampler, tube: jt.Tube, seconds: float) -> dict[str, Any]:
    """A method's row, after a short run that compiles."""
    sample(Looks(tube, 2.0))
    looks = Looks(tube, seconds)
    energies = sample(looks)
    took = looks.seconds()
    row: dict[str, Any] = {"method": name, "seconds": took, "moves": looks.moves, "contacts_kept": looks.kept()}
    for quantity, series in zip(QUANTITIES, (energies, looks.variance, looks.neighbors), strict=True):
        row[quantity] = told(np.asarray(series), took)
    return row


def samplers(tube: jt.Tube, cells: int, temperature: float, seed: int) -> dict[str, Sampler]:
    """The methods: each samples until the looks say that time is up, and returns the energies."""
    start, model = tube.random_positions(jax.random.key(0), cells), jt.tube_model(tube, cells)
    endless = 10**6

    def single(algorithm: str, looks: Looks) -> np.ndarray:
        annealer = jt.Annealer(model, "draft", algorithm, seed, np.full(endless, temperature))
        state, energies, ended = annealer.start(start), [], False
        while not ended:
            state, records, trail = annealer.advance(state)
            energies += [record.energy for record in records]
            ended = max([looks(positions) for positions in trail])
        return np.array(energies)

    def tempered(looks: Looks) -> np.ndarray:
        ladder = temperature * LADDER
        found = jt.temper(start, model, ladder, endless, seed, callback=lambda _, positions: looks(positions[0]))
        print(found)
        return found.energies[1:, 0]

    def langevin(looks: Looks) -> np.ndarray:
        found = jt.sample_langevin(
            relaxed, model, temperature, endless, 1000, seed=seed, callback=lambda _, positions: looks(positions)
        )
        print(found)
        return found.energies

    relaxed = jt.relax(start, model, steps=5).positions
    return {
        "mh": lambda looks: single("mh", looks),
        "is-mh": lambda looks: single("is-mh", looks),
        "tempering": tempered,
        "langevin": langevin,
    }


def main() -> None:
    """Run the methods, compare them with the first, and write the table."""
    parser = common.options((__doc__ or "").split("\n")[0], "samplers")
    parser.add_argument("--cells", type=int, default=30)
    parser.add_argument("--temperature", type=float, default=2.0)
    parser.add_argument("--minutes", type=float, default=1.5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--methods", nargs="+", default=["mh", "is-mh", "tempering", "langevin"])
    options = parser.parse_args()
    tube = jt.Tube(options.cells / 5, 2.0, 5.0)
    known, rows = samplers(tube, options.cells, options.temperature, options.seed), []
    for name in options.methods:
        rows.append(run(name, known[name], tube, 60 * options.minutes))
        for quantity in QUANTITIES:
            here, first = rows[-1][quantity], rows[0][quantity]
            errors = float(np.hypot(here["error"], first["error"]))
            here["z"] = (here["mean"] - first["mean"]) / errors
        print(rows[-1], flush=True)
    sizes = {name: getattr(options, name) for name in ("cells", "temperature", "minutes", "seed")}
    load = {"load_average": os.getloadavg(), "cores": len(os.sched_getaffinity(0))}
    common.write(options.out, sizes | {"ladder": LADDER.tolist()} | load | {"rows": rows})


if __name__ == "__main__":
    main()
