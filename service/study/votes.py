"""Trials and votes of a study, in `study.sqlite` of its folder; nothing in it is ever changed, only added to."""

import random
import secrets
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from service.study.films import Pair

Answer = Literal["left", "equal", "right"]

FILE_NAME = "study.sqlite"
SCHEMA = """
CREATE TABLE IF NOT EXISTS trials (
    id TEXT PRIMARY KEY, participant TEXT NOT NULL, tree TEXT NOT NULL, left TEXT NOT NULL, right TEXT NOT NULL,
    shown_at TEXT NOT NULL DEFAULT CURRENT_TIMESTAMP
);
CREATE TABLE IF NOT EXISTS votes (
    trial TEXT NOT NULL REFERENCES trials(id), question TEXT NOT NULL, answer TEXT NOT NULL,
    voted_at TEXT NOT NULL DEFAULT CURRENT_TIMESTAMP, PRIMARY KEY (trial, question)
);
"""


@dataclass(frozen=True)
class Trial:
    """Two films beside each other. The id, which the page has, tells nothing of the methods."""

    id: str
    participant: str
    tree: str
    left: str
    right: str


@dataclass(frozen=True)
class Vote:
    """An answer with what it was about."""

    trial: Trial
    question: str
    answer: Answer


class Votes:
    """The database of one study; every call opens it anew, so that any thread may call."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / FILE_NAME
        with self._opened() as database:
            database.executescript(SCHEMA)

    def next_trial(self, participant: str, pairs: Sequence[Pair]) -> tuple[Trial | None, int]:
        """The trial that this participant left open, or a new one; None after the last. And how many are answered.

        Order of pairs and sides are drawn at random for each participant.
        """
        with self._opened() as database:
            trials = {trial.id: trial for trial in self._trials(database, participant)}
            answered = {
                row["trial"]
                for row in database.execute(
                    "SELECT DISTINCT trial FROM votes JOIN trials ON trials.id = trial WHERE participant = ?",
                    (participant,),
                )
            }
            open_trial = next((trial for name, trial in trials.items() if name not in answered), None)
            if open_trial is not None:
                return open_trial, len(answered)
            done = {Pair(trial.tree, *sorted((trial.left, trial.right))) for trial in trials.values()}
            left_over = [pair for pair in pairs if pair not in done]
            if not left_over:
                return None, len(answered)
            pair = random.choice(left_over)
            left, right = random.sample([pair.first, pair.second], 2)
            trial = Trial(secrets.token_urlsafe(12), participant, pair.tree, left, right)
            database.execute(
                "INSERT INTO trials (id, participant, tree, left, right) VALUES (?, ?, ?, ?, ?)",
                (trial.id, participant, trial.tree, left, right),
            )
            return trial, len(answered)

    def trial(self, trial_id: str, participant: str) -> Trial | None:
        """A trial of this participant; None if it is another's or no one's."""
        with self._opened() as database:
            return next((one for one in self._trials(database, participant) if one.id == trial_id), None)

    def vote(self, trial: Trial, answers: dict[str, Answer]) -> bool:
        """Store the answers to all questions of a trial; False, and nothing stored, if it has been answered."""
        rows = [(trial.id, question, answer) for question, answer in answers.items()]
        try:
            with self._opened() as database:
                database.executemany("INSERT INTO votes (trial, question, answer) VALUES (?, ?, ?)", rows)
        except sqlite3.IntegrityError:
            return False
        return True

    def all(self) -> list[Vote]:
        """Every vote, oldest first."""
        with self._opened() as database:
            trials = {trial.id: trial for trial in self._trials(database)}
            rows = database.execute("SELECT trial, question, answer FROM votes ORDER BY voted_at, rowid").fetchall()
        return [Vote(trials[row["trial"]], row["question"], row["answer"]) for row in rows]

    @staticmethod
    def _trials(database: sqlite3.Connection, participant: str | None = None) -> list[Trial]:
        rows = database.execute(
            "SELECT id, participant, tree, left, right FROM trials WHERE ? IS NULL OR participant = ? ORDER BY rowid",
            (participant, participant),
        )
        return [Trial(**row) for row in rows]

    @contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        """One transaction: committed at the end, rolled back on an error."""
        with closing(sqlite3.connect(self._path, timeout=10)) as database:
            database.row_factory = sqlite3.Row
            with database:
                database.execute("BEGIN IMMEDIATE")
                yield database
