"""The page of a study: two films, four questions, no word of which method made which."""

import secrets
from pathlib import Path
from typing import Annotated

from fastapi import Cookie, FastAPI, HTTPException, Request, Response
from fastapi.responses import FileResponse, JSONResponse
from pydantic import BaseModel, ConfigDict
from starlette.middleware.base import RequestResponseEndpoint

from service.study.films import MEDIA_TYPES, Films
from service.study.votes import Answer, Votes

PAGE = Path(__file__).parent / "page"
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; media-src 'self'; img-src 'self' data:; "
    "connect-src 'self'"
)
COOKIE = "participant"
A_YEAR_S = 365 * 24 * 3600

QUESTIONS = {
    "MA": ("Motion authenticity", "Which tree moves more like a real one in the wind?"),
    "MC": ("Motion complexity", "Which motion is richer: trunk, branches and leaves each in their own way?"),
    "SC": ("3D structural consistency", "Which tree keeps its shape better, with nothing torn, bent or swollen?"),
    "VQ": ("Visual quality", "Which film looks better?"),
}


class TrialView(BaseModel):
    """What the page is given of a trial; the methods' names are not in it."""

    id: str
    left: str  # address of the film
    right: str
    kind: str  # media type of both: "video" or "image"


class NextTrial(BaseModel):
    """The next trial, none after the last, and how far the participant is."""

    trial: TrialView | None
    answered: int
    of: int
    questions: dict[str, tuple[str, str]]


class Answers(BaseModel):
    """One answer to each of `QUESTIONS`."""

    model_config = ConfigDict(extra="forbid")

    MA: Answer
    MC: Answer
    SC: Answer
    VQ: Answer


def create_study(films: Films, votes: Votes) -> FastAPI:
    """An application of its own, apart from the service's API."""
    app = FastAPI(title="DynamicTree study", docs_url=None, redoc_url=None, openapi_url=None)
    pairs = films.pairs()

    @app.middleware("http")
    async def protect(request: Request, answer_next: RequestResponseEndpoint) -> Response:
        origin = request.headers.get("origin")
        if request.method == "POST" and origin and origin.partition("//")[2] != request.headers.get("host"):
            return JSONResponse({"detail": "votes come from the study's own page"}, 403)
        response = await answer_next(request)
        response.headers.update(
            {"content-security-policy": POLICY, "x-content-type-options": "nosniff", "cache-control": "no-store"}
        )
        return response

    @app.get("/")
    def page(participant: Annotated[str | None, Cookie()] = None) -> FileResponse:
        response = FileResponse(PAGE / "index.html")
        if participant is None:
            response.set_cookie(COOKIE, secrets.token_urlsafe(12), max_age=A_YEAR_S, httponly=True, samesite="strict")
        return response

    @app.get("/page/{name}")
    def part_of_page(name: str) -> FileResponse:
        if name not in ("study.js", "style.css"):
            raise HTTPException(404, f"no file {name}")
        return FileResponse(PAGE / name)

    @app.get("/next")
    def next_trial(participant: Annotated[str, Cookie()]) -> NextTrial:
        trial, answered = votes.next_trial(participant, pairs)
        view = None
        if trial is not None:
            kind = _media_type(films.file(trial.left, trial.tree)).partition("/")[0]
            view = TrialView(id=trial.id, left=f"/trials/{trial.id}/left", right=f"/trials/{trial.id}/right", kind=kind)
        return NextTrial(trial=view, answered=answered, of=len(pairs), questions=QUESTIONS)

    @app.get("/trials/{trial_id}/{side}")
    def film(trial_id: str, side: str, participant: Annotated[str, Cookie()]) -> FileResponse:
        trial = votes.trial(trial_id, participant)
        if trial is None or side not in ("left", "right"):
            raise HTTPException(404, "no such film")
        path = films.file(trial.left if side == "left" else trial.right, trial.tree)
        return FileResponse(path, media_type=_media_type(path))

    @app.post("/trials/{trial_id}")
    def vote(trial_id: str, answers: Answers, participant: Annotated[str, Cookie()]) -> dict[str, bool]:
        trial = votes.trial(trial_id, participant)
        if trial is None:
            raise HTTPException(404, "no such trial")
        if not votes.vote(trial, answers.model_dump()):
            raise HTTPException(409, "this trial has been answered")
        return {"stored": True}

    return app


def _media_type(path: Path) -> str:
    return MEDIA_TYPES[path.suffix.lower()]
