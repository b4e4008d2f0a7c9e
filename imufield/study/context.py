"""What all studies of one invocation share: seed, number of runs, and workers."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

from imufield.campaign import Argument, Result, Run, run_campaign
from imufield.dataclass import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyContext:
    """Hashable, so that studies of the same runs can share them."""

    seed: int = 0
    quick: bool = False
    """Few runs: enough to see that it works, not to quote."""
    workers: int | None = None
    scheduler: str | None = None

    def runs(self, full: int, quick: int) -> int:
        """Return the number of runs."""
        return quick if self.quick else full

    def campaign(self, name: str, run: Run[Argument, Result], arguments: Sequence[Argument]) -> list[Result]:
        """Do the runs of a study; each name has random numbers of its own."""
        seed = zlib.crc32(f"{self.seed} {name}".encode())
        # The name is part of the seed, so a study has the same runs whether it is done alone or with others.
        return run_campaign(run, arguments, seed=seed, workers=self.workers, scheduler=self.scheduler)

    def campaign_of_each(
        self, name: str, run: Run[Argument, Result], arguments: Sequence[Argument], runs: int
    ) -> list[list[Result]]:
        """Do ``runs`` runs for each argument; return them argument by argument."""
        found = self.campaign(name, run, [argument for argument in arguments for _ in range(runs)])
        return [found[k * runs : (k + 1) * runs] for k in range(len(arguments))]
