"""A blind study: sides hide the methods, every pair is seen once, and one person's votes count as one observation."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from typer.testing import CliRunner

from service.study.app import QUESTIONS, create_study
from service.study.command import app as command
from service.study.films import Pair, StudyError, find_films
from service.study.results import preferences, wilson_interval
from service.study.votes import Votes

METHODS, TREES = ("ours", "rival"), ("lime", "oak", "palm")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for method in METHODS:
        (tmp_path / method).mkdir()
        for tree in TREES:
            (tmp_path / method / f"{tree}.mp4").write_bytes(f"{method} {tree}".encode())
    return tmp_path


@pytest.fixture
def visitor(folder: Path) -> Iterator[TestClient]:
    with TestClient(create_study(find_films(folder), Votes(folder)), "http://localhost") as client:
        assert client.get("/").status_code == 200
        yield client


def all_alike(answer: str) -> dict[str, str]:
    return dict.fromkeys(QUESTIONS, answer)


def prefer(client: TestClient, method: str) -> int:
    """Answer every trial for the side whose film is the method's; the number of trials."""
    count = 0
    while (trial := client.get("/next").json()["trial"]) is not None:
        side = next(side for side in ("left", "right") if client.get(trial[side]).text.startswith(method))
        assert client.post(f"/trials/{trial['id']}", json=all_alike(side)).status_code == 200
        count += 1
    return count


def test_a_method_that_is_always_preferred_has_all_votes_wherever_it_stands(visitor: TestClient, folder: Path) -> None:
    assert prefer(visitor, "rival") == len(TREES)
    votes = Votes(folder).all()
    assert {vote.trial.tree for vote in votes} == set(TREES)
    rows = preferences(votes)
    assert {row.question for row in rows} == set(QUESTIONS)
    assert all((row.method, row.other, row.share, row.participants) == ("ours", "rival", 0, 1) for row in rows)


def test_the_page_learns_no_method(visitor: TestClient, folder: Path) -> None:
    trial = visitor.get("/next")
    seen = trial.text + "".join(f"{visitor.get(trial.json()['trial'][side]).headers}" for side in ("left", "right"))
    assert not any(method in seen for method in METHODS)


def test_both_sides_get_both_methods(folder: Path) -> None:
    votes, pairs = Votes(folder), find_films(folder).pairs()
    sides = {votes.next_trial(f"person {number}", pairs)[0].left for number in range(40)}
    assert sides == set(METHODS)  # fails by chance once in 2^39


def test_a_page_that_is_loaded_again_shows_the_same_trial(visitor: TestClient) -> None:
    first = visitor.get("/next").json()
    assert visitor.get("/next").json() == first


def test_a_vote_is_stored_once_and_whole(visitor: TestClient, folder: Path) -> None:
    trial = visitor.get("/next").json()["trial"]["id"]
    assert visitor.post(f"/trials/{trial}", json={"MA": "left"}).status_code == 422
    assert visitor.post(f"/trials/{trial}", json=all_alike("up")).status_code == 422
    assert Votes(folder).all() == []
    assert visitor.post(f"/trials/{trial}", json=all_alike("left")).status_code == 200
    assert visitor.post(f"/trials/{trial}", json=all_alike("right")).status_code == 409
    assert {vote.answer for vote in Votes(folder).all()} == {"left"}


def test_nobody_votes_for_another_or_from_another_page(visitor: TestClient) -> None:
    trial = visitor.get("/next").json()["trial"]["id"]
    foreign = {"origin": "http://elsewhere.example"}
    assert visitor.post(f"/trials/{trial}", json=all_alike("left"), headers=foreign).status_code == 403
    visitor.cookies.clear()
    visitor.cookies.set("participant", "another")
    assert visitor.post(f"/trials/{trial}", json=all_alike("left")).status_code == 404
    assert visitor.get(f"/trials/{trial}/left").status_code == 404


def test_many_votes_of_one_person_are_one_observation(folder: Path) -> None:
    votes, films = Votes(folder), find_films(folder)
    for person in ("a", "b"):
        while (trial := votes.next_trial(person, films.pairs())[0]) is not None:
            votes.vote(trial, {"MA": "left" if trial.left == "ours" else "right"} if person == "a" else {"MA": "equal"})
    (row,) = preferences(votes.all())
    assert (row.share, row.participants, row.votes) == (0.75, 2, 6)
    assert (row.low, row.high) == wilson_interval(0.75, 2)


@pytest.mark.parametrize(
    ("share", "count", "expected"),
    [(0.5, 10, (0.2366, 0.7634)), (0.0, 10, (0.0, 0.2775)), (0.9, 100, (0.8256, 0.9448))],
)
def test_intervals_are_wilsons(share: float, count: int, expected: tuple[float, float]) -> None:
    """Values of statsmodels' `proportion_confint(..., method="wilson")`."""
    assert wilson_interval(share, count) == pytest.approx(expected, abs=1e-4)


def test_films_of_three_methods_make_three_pairs_a_tree(folder: Path) -> None:
    (folder / "truth").mkdir()
    (folder / "truth" / "oak.webm").write_bytes(b"")
    assert find_films(folder).pairs().count(Pair("oak", "ours", "truth")) == 1
    assert len(find_films(folder).pairs()) == len(TREES) + 2


def test_a_folder_without_pairs_says_how_films_are_laid(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"METHOD/TREE\.mp4"):
        find_films(tmp_path)
    result = CliRunner().invoke(command, ["serve", str(tmp_path)])
    assert (result.exit_code, "METHOD/TREE.mp4" in result.output) == (2, True)


def test_results_are_printed_with_their_interval(visitor: TestClient, folder: Path) -> None:
    prefer(visitor, "ours")
    result = CliRunner().invoke(command, ["results", str(folder)])
    assert "MA    ours preferred to rival: 100% (95 % interval 21% to 100%; 1 participants, 3 votes)" in result.output
