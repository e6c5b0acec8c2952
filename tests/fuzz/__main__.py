"""`python -m tests.fuzz --files 10000 --seed 1 --state FOLDER`: mutated files of every format, each in a fork.

The same seed makes the same files. What is done is written to the folder, so that a run that was stopped goes on; each
file at fault lies there beside its story. Exits with 1 if there is any.
"""

import argparse
import json
import random
import sys
from collections import Counter
from pathlib import Path

from tests.fuzz.bombs import BOMBS, MOST_MIB
from tests.fuzz.forks import Outcome, attempt
from tests.fuzz.mutate import mutated
from tests.fuzz.readers import READERS
from tests.fuzz.seeds import seeds

AT_LEAST = 500
"""Files of every format."""

BOMB_CPU_S = 30
"""A bomb may be read to the end, where its budget allows it."""


def case(kind: str, index: int, seed: int, good: dict[str, list[bytes]]) -> bytes:
    """The file with this number."""
    rng = random.Random(f"{seed}-{kind}-{index}")
    return mutated(rng.choice(good[kind]), good[kind], rng)


def fuzz(folder: Path, *, files: int, seed: int) -> dict[str, object]:
    """Read so many files; what became of them, by format."""
    folder.mkdir(parents=True, exist_ok=True)
    good = seeds()
    for kind, samples in good.items():
        for sample in samples:
            outcome = attempt(READERS[kind], sample)
            assert outcome.verdict == "read", f"a good {kind} file: {outcome.detail}"
    each = max(AT_LEAST, -(-files // len(good)))
    report: dict[str, object] = {}
    faults = 0
    for kind in good:
        done = folder / f"{kind}-{seed}.jsonl"
        begin = sum(1 for _ in done.open()) if done.exists() else 0
        with done.open("a") as log:
            for index in range(begin, each):
                content = case(kind, index, seed, good)
                outcome = attempt(READERS[kind], content)
                row = {"i": index, "verdict": outcome.verdict, "s": round(outcome.seconds, 3)}
                log.write(json.dumps(row | {"mib": round(outcome.peak_mib)}) + "\n")
                log.flush()
                if outcome.faulty:
                    keep(folder, kind, index, content, outcome)
        rows = [json.loads(line) for line in done.open()]
        verdicts = Counter(row["verdict"] for row in rows)
        faults += len(rows) - verdicts["read"] - verdicts["refused"]
        worst = {"max_s": max(row["s"] for row in rows), "max_mib": max(row["mib"] for row in rows)}
        report[kind] = dict(verdicts) | worst
        sys.stdout.write(json.dumps({kind: report[kind]}) + "\n")
        sys.stdout.flush()
    bombs, failed = expand(folder)
    plan = {"files": each * len(good), "formats": len(good), "each": each, "seed": seed}
    return plan | {"bombs": bombs, "faults": faults + failed}


def expand(folder: Path) -> tuple[int, int]:
    """Try every expansion bomb; how many there are, and how many cost more than they may."""
    failed = 0
    for name, (make, read, verdict) in BOMBS.items():
        content = make()
        outcome = attempt(read, content, cpu_s=BOMB_CPU_S)
        over = outcome.verdict != verdict or outcome.peak_mib >= MOST_MIB + len(content) / 2**20
        row = {"bomb": name, "bytes": len(content), "verdict": outcome.verdict}
        row |= {"s": round(outcome.seconds, 1), "mib": round(outcome.peak_mib)}
        sys.stdout.write(json.dumps(row) + "\n")
        sys.stdout.flush()
        if over:
            failed += 1
            keep(folder, f"bomb-{name.replace(' ', '-')}", 0, content, outcome)
    return len(BOMBS), failed


def keep(folder: Path, kind: str, index: int, content: bytes, outcome: Outcome) -> None:
    (folder / f"{kind}-{index}.bin").write_bytes(content)
    (folder / f"{kind}-{index}.txt").write_text(f"{outcome.verdict}\n{outcome.detail}\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--state", type=Path, required=True, help="folder of what is done and of what failed")
    given = parser.parse_args()
    report = fuzz(given.state, files=given.files, seed=given.seed)
    sys.stdout.write(json.dumps(report) + "\n")
    if report["faults"]:
        sys.exit(f"{report['faults']} files at fault; see {given.state}")


if __name__ == "__main__":
    main()
