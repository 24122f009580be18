"""Run a protocol task by task: results are kept as they come, and a run that is cut off resumes."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from rich.progress import track

from .parallel import in_parallel
from .report import MADE_WITH, code, earlier, entries, keep, reporting, without_maker

Entry = dict[str, Any]
"""A result: a line of JSON."""

_OF_A_RUN = frozenset(["out", "add", "seconds", "workers", "report"])
"""Options that say what is done or kept, and change no result."""


class Runner:
    """The options of a protocol, and the file of its results.

    Parameters
    ----------
    doc : str
        Docstring of the protocol's module.
    out : str
        Default file of the results.
    first_seed : int, optional
        Seed of the first world, of a protocol that makes its worlds.
    worlds : int
        Default number of worlds, one a seed.
    parallel : bool
        Add ``--workers``; the work is then a function of a module.
    choosing : sequence of str
        Options that choose among tasks or how results are shown, and change none of them.
    """

    args: argparse.Namespace

    def __init__(
        self,
        doc: str | None,
        out: str,
        *,
        first_seed: int | None = None,
        worlds: int = 1,
        parallel: bool = False,
        choosing: Sequence[str] = (),
    ) -> None:
        seeds = () if first_seed is None else ("worlds", "first_seed")
        self._free = _OF_A_RUN | {*choosing, *seeds}
        self.options = reporting(doc)
        add = self.options.add_argument
        add("--out", type=Path, default=Path(out), help="results; a run resumes from them")
        add("--add", type=Path, nargs="+", metavar="FILE", help="only add up earlier runs")
        add("--seconds", type=float, default=float("inf"), help="begin nothing after these")
        self.options.set_defaults(workers=1)
        if parallel:
            add("--workers", type=int, help="processes")
        if first_seed is not None:
            add("--worlds", type=int, default=worlds)
            add("--first-seed", type=int, default=first_seed)

    def parse(self) -> argparse.Namespace:
        """Read the command line; its time begins."""
        self.args = self.options.parse_args()
        self._ends = time.monotonic() + self.args.seconds
        return self.args

    @property
    def seeds(self) -> range:
        """Seeds of the worlds."""
        return range(self.args.first_seed, self.args.first_seed + self.args.worlds)

    @cached_property
    def made_with(self) -> Entry:
        """Code and options that results depend on; results of any other are not resumed."""
        options = {key: value for key, value in vars(self.args).items() if key not in self._free}
        return {"code": code(), **{key: str(options[key]) for key in sorted(options)}}

    def results(self) -> list[Entry]:
        """Read the results: of the files to add up, or of this run and those it resumes.

        Raises
        ------
        ConfigError
            If the files to add up are of different code or options.
        """
        if self.args.add:
            return entries(*self.args.add)
        found = [each for each in earlier(self.args.out) if each.get(MADE_WITH) == self.made_with]
        if hasattr(self.args, "first_seed"):
            found = [each for each in found if each.get("seed", self.seeds[0]) in self.seeds]
        return without_maker(found)

    def keep(self, result: Mapping[str, Any]) -> None:
        """Add a result to the file."""
        keep(self.args.out, {**result, MADE_WITH: self.made_with})

    def run(
        self,
        work: Callable[[Any], Entry | None],
        tasks: Iterable[Any],
        names: Sequence[str],
        key: Callable[[Any], Iterable[Any]] = tuple,
    ) -> list[Entry]:
        """Do the tasks without a result, none with ``--add``, and return all results.

        Parameters
        ----------
        work : callable
            Makes the result of a task, or None.
        names : sequence of str
            Values of a result that tell its task from others.
        key : callable
            Makes these values of a task.
        """
        if not self.args.add:
            done = [[entry.get(name) for name in names] for entry in self.results()]
            left = [task for task in tasks if [*key(task)] not in done]
            found = in_parallel(work, left, self.args.workers)
            for _, result in track(found, Path(self.args.out).stem, total=len(left)):
                if result is not None:
                    self.keep(result)
                if time.monotonic() > self._ends:
                    break
        return self.results()
