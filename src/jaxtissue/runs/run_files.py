"""The files of a run: written at its start, and read when it is resumed."""

import hashlib
import os
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from jaxtissue.compilation.modes import random_key
from jaxtissue.dynamics.annealer import Annealer, AnnealState, renews_at
from jaxtissue.dynamics.memory import tell_memory
from jaxtissue.geometry.domain_files import save_domain
from jaxtissue.geometry.domain_positions import column_names
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.tube import Tube
from jaxtissue.runs import storage
from jaxtissue.runs.backbone_files import BackboneTable, read_backbones
from jaxtissue.runs.reports import CONTACT_TABLES
from jaxtissue.runs.run_folders import BACKBONES, CELLS, CHECKPOINT, DOMAIN, FIGURES, FILES, INITIAL, MANIFEST, SWEEPS
from jaxtissue.runs.settings import FORMAT, Settings, provenance, saved_settings
from jaxtissue.system.files import (
    check_files,
    checksum,
    make_folder,
    open_own,
    read_sealed,
    write_sealed,
)

RESULTS = (DOMAIN, INITIAL, BACKBONES, CELLS, SWEEPS, *CONTACT_TABLES, *FIGURES)
NEEDED = ("arguments", "cooling_sweeps", "compile_seconds", "files", "finished", "resumed")  # of a manifest
AGAIN = "add --force to start again from the beginning"


@dataclass
class Run:
    """A run under way: what it does, where it stands, and its manifest so far."""

    folder: Path
    settings: Settings
    annealer: Annealer
    state: AnnealState
    kept: dict[int, np.ndarray]  # positions after some sweeps, for the figures
    names: tuple[str, ...] | None
    manifest: dict[str, Any]
    rows: Any  # running checksum of sweeps.csv

    def save(self) -> None:
        """Write the checkpoint; the rows of sweeps.csv up to it must be on the disk before.

        Only between spans of sweeps, where a longer run would be too: the odd sweeps at a run's end are
        played again if it goes on.
        """
        if not renews_at(self.state.sweep):
            return
        kept = np.array(list(self.kept)), np.stack(list(self.kept.values()))
        checkpoint = storage.Checkpoint(self.state, *kept, self.rows.hexdigest())
        storage.save_checkpoint(self.folder / CHECKPOINT, checkpoint)

    def write_manifest(self, **news: Any) -> None:
        """Write the manifest with what is new."""
        self.manifest |= news
        write_sealed(self.folder / MANIFEST, self.manifest)

    def checksums(self, *names: str) -> dict[str, str]:
        """Checksums of those of the files that are there."""
        return {name: checksum(self.folder / name) for name in names if (self.folder / name).is_file()}

    def cut(self) -> None:
        """Remove the rows of sweeps.csv that are not in the checkpoint."""
        storage.cut_sweeps(self.folder / SWEEPS, self.state.sweep, self.rows.hexdigest())

    def note_resumption(self) -> None:
        """Write into the manifest that the run goes on, and with what."""
        again = {"at_sweep": self.state.sweep} | provenance()
        news = {"arguments": asdict(self.settings), "resumed": [*self.manifest["resumed"], again]}
        self.write_manifest(**news, finished=None, files=self.checksums(INITIAL))


def initial_backbones(settings: Settings, bent: bool = False) -> BackboneTable:
    """The backbones that a run begins with, `bent` ones if it takes these, and their names."""
    if settings.backbones:
        return read_backbones(Path(settings.backbones), settings.place, settings.degrees, bent)
    key = random_key(settings.seed)
    return BackboneTable(np.asarray(settings.place.random_positions(key, settings.cells)), None)


def begin(
    folder: Path, settings: Settings, annealer: Annealer, initial: np.ndarray, names: tuple[str, ...] | None
) -> Run:
    """A run before its first sweep, with its first checkpoint on the disk."""
    started = provenance()
    domain = settings.place
    if isinstance(domain, Tube):
        say(tell_memory(len(initial), domain, settings.resolution, 8 if settings.x64 else 4))
    say(f"annealing {len(initial)} cells in {folder}: compiling")
    state = annealer.start(domain.reflect(jnp.asarray(initial)) if initial.ndim == 2 else initial)
    record = annealer.record(state)
    make_folder(folder, FILES)
    storage.write_backbones(folder / INITIAL, initial, names, column_names(domain))
    if settings.domain is not None:
        save_domain(domain, folder / DOMAIN)
    manifest = {"format": FORMAT, "arguments": asdict(settings), "cooling_sweeps": settings.sweeps} | started
    manifest |= {"finished": None, "compile_seconds": 0.0, "resumed": []}
    run = Run(folder, settings, annealer, state, {0: state.positions}, names, manifest, hashlib.sha256())
    run.write_manifest(files=run.checksums(INITIAL))
    with open_own(folder / SWEEPS, "w") as table:
        run.rows.update(storage.write_sweep(table, record))
        os.fsync(table.fileno())
    run.save()
    return run


def take_up(folder: Path, given: Mapping[str, Any], finish: bool) -> Run | None:
    """The run at its checkpoint; none where it is finished and not to be finished again."""
    manifest = read_sealed(folder / MANIFEST, AGAIN)
    settings = saved_settings(manifest, given, str(folder))
    if missing := [name for name in NEEDED if name not in manifest]:
        raise ValueError(f"{folder / 'manifest.json'} is damaged ({missing[0]!r} is missing); {AGAIN}")
    jax.config.update("jax_enable_x64", settings.x64)
    check_files(folder, {INITIAL: manifest["files"][INITIAL]}, AGAIN)
    bent = isinstance(settings.place, Domain)
    initial = read_backbones(folder / INITIAL, settings.place, bent=bent)
    if given.get("backbones"):
        same = read_backbones(Path(given["backbones"]), settings.place, settings.degrees, bent)
        if same.names != initial.names or not np.array_equal(same.positions, initial.positions):
            raise ValueError(
                f"--backbones {given['backbones']} differs from the backbones of the run to resume; remove --backbones"
            )
    checkpoint = storage.load_checkpoint(folder / CHECKPOINT)
    rows = storage.cut_sweeps(folder / SWEEPS, checkpoint.state.sweep, checkpoint.rows, keep=True)
    if manifest["finished"] and settings.sweeps == manifest["arguments"]["sweeps"] and not finish:
        check_files(folder, manifest["files"], "write it again with jaxtissue anneal --resume --finish")
        return None
    kept = dict(zip(checkpoint.kept_sweeps.tolist(), checkpoint.kept_positions, strict=True))
    annealer = settings.annealer(manifest["cooling_sweeps"])
    return Run(folder, settings, annealer, checkpoint.state, kept, initial.names, manifest, rows)


def say(text: str) -> None:
    """Print a line for the user, past the progress bar."""
    tqdm.write(text, file=sys.stderr)
