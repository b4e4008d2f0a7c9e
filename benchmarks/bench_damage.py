"""Ten minutes of sample time of every serial form under damage, counted to the last frame.

Bits flip at 1e-4 of all bytes, single bytes get lost at 1e-5, stretches of up to 20 ms every ten seconds; ``--outages`` loses
0.3 s to 3 s besides in every ten, beyond the wrap of every counter. Every intact frame must be decoded, no frame with a wrong
checksum, and the decoder's own count of losses must be the true one; forms without a checksum can only be looked at.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

from tests.simulate.accounting import Account, Wire, account_for, has_checksum, serial_wires

PRINTS = True
"""Its rows are accounts in words and counts, not one figure each."""
BY_HOST_TIME = ("vectornav_ascii", "witmotion")


def verdict(wire: Wire, account: Account) -> str:
    """Return what is wrong, or that all is well."""
    if not has_checksum(wire.choose().protocol):
        return "excepted: no checksum"
    if account.samples_missed or account.samples_false or account.frames_decoded < account.frames_intact:
        return "WRONG: frames"
    known = account.counted_lost + account.estimated_lost
    if wire.driver in BY_HOST_TIME:
        return f"as it should be; losses by host time: {known} of {account.missing}"
    return "as it should be" if known == account.missing else f"WRONG: losses {known}, true {account.missing}"


def run(seconds: float = 600.0, *, outages: bool = False, only: str = "") -> list[dict[str, Any]]:
    """Return one row for each wire."""
    rows = []
    for wire in serial_wires():
        if str(wire).startswith(only):
            begin = time.process_time()
            account = account_for(wire, seconds, outages=outages)
            used_s = time.process_time() - begin
            rows.append({"name": str(wire), "account": account, "verdict": verdict(wire, account), "used_s": used_s})
    return rows


def main() -> None:
    """Print the figures as a table."""
    parser = argparse.ArgumentParser(description="damage, counted")
    parser.add_argument("--seconds", type=float, default=600.0, help="of sample time for each form")
    parser.add_argument("--outages", action="store_true", help="lose 0.3 s to 3 s at once too")
    parser.add_argument("--only", default="", help="beginning of a name")
    options = parser.parse_args()
    heads = ("frames sent", "intact", "decoded", "missed", "false", "lost", "counted", "estimated")
    print(f"{'':30}" + "".join(f"{head:>12}" for head in heads))
    for row in run(options.seconds, outages=options.outages, only=options.only):
        found: Account = row["account"]
        numbers = (
            found.frames_sent,
            found.frames_intact,
            found.frames_decoded,
            found.samples_missed,
            found.samples_false,
            found.missing,
            found.counted_lost,
            found.estimated_lost,
        )
        print(f"{row['name']:30}" + "".join(f"{number:12}" for number in numbers) + f"  {row['verdict']}", flush=True)


if __name__ == "__main__":
    main()
