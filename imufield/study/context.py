"""What every study of one run shares: seed, size, and who does the work."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field

from imufield.study.campaign import Argument, Progress, Result, Run, run_campaign


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyContext:
    """Hashable, so that studies of the same runs can share them."""

    seed: int = 0
    quick: bool = False
    """Few runs: enough to see that it works, not to quote."""
    workers: int | None = None
    scheduler: str | None = None
    progress: Progress | None = field(default=None, compare=False)

    def runs(self, full: int, quick: int) -> int:
        """Return the number of runs."""
        return quick if self.quick else full

    def campaign(self, name: str, run: Run[Argument, Result], arguments: Sequence[Argument]) -> list[Result]:
        """Do the runs of a study; each name has random numbers of its own."""
        seed = zlib.crc32(f"{self.seed} {name}".encode())
        return run_campaign(run, arguments, seed=seed, workers=self.workers, scheduler=self.scheduler, progress=self.progress)
