"""What the votes of a study say: how often a method was preferred, with a 95 % interval."""

import math
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

from service.study.votes import Vote

QUANTILE = 1.959964  # of the normal distribution, for 95 %


@dataclass(frozen=True, kw_only=True)
class Preference:
    """How often `method` was preferred to `other` in one question; an "equal" counts half for each."""

    question: str
    method: str
    other: str
    share: float  # mean over participants of each one's own share
    low: float  # 95 % interval
    high: float
    participants: int
    votes: int


def preferences(votes: Iterable[Vote]) -> list[Preference]:
    """One row per question and pair of methods, sorted.

    Votes of one person are not independent: each participant counts as one observation, whose value is the share of
    the votes. The interval is Wilson's score interval for that many observations. It is wider than one that
    counts votes, and does not shrink to nothing where all agree.
    """
    won: dict[tuple[str, str, str], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for vote in votes:
        first, second = sorted((vote.trial.left, vote.trial.right))
        of_left = {"left": 1.0, "equal": 0.5, "right": 0.0}[vote.answer]
        of_first = of_left if vote.trial.left == first else 1 - of_left
        won[vote.question, first, second][vote.trial.participant].append(of_first)
    rows = []
    for (question, first, second), by_participant in sorted(won.items()):
        shares = [sum(own) / len(own) for own in by_participant.values()]
        share = sum(shares) / len(shares)
        low, high = wilson_interval(share, len(shares))
        rows.append(
            Preference(
                question=question,
                method=first,
                other=second,
                share=share,
                low=low,
                high=high,
                participants=len(shares),
                votes=sum(len(own) for own in by_participant.values()),
            )
        )
    return rows


def wilson_interval(share: float, count: int) -> tuple[float, float]:
    """Wilson's 95 % score interval of a share seen in `count` independent observations (Wilson 1927)."""
    square = QUANTILE**2 / count
    middle = (share + square / 2) / (1 + square)
    half = math.sqrt(share * (1 - share) * square + square**2 / 4) / (1 + square)
    return middle - half, middle + half
