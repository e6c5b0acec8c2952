"""The blocking client. Made by client/generate.py; do not edit."""

import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar
from uuid import uuid4

import httpx

from dynamictree_client import operations
from dynamictree_client.call import Call
from dynamictree_client.errors import JobEndedError, UnreachableError, WaitTimeoutError, problem_of
from dynamictree_client.files import (
    OUT_OF_STEP,
    PIECE,
    TUS,
    PathLike,
    bytes_there,
    chosen_files,
    finish,
    form_of,
    piece_headers,
    place_of,
    upload_headers,
)
from dynamictree_client.models import (
    AnimateParams,
    AnimateRequest,
    Artifact,
    Asset,
    Interact,
    InteractRequest,
    Job,
)
from dynamictree_client.retries import Retries, retry_after_s

T = TypeVar("T")
RESUMABLE_ABOVE = 32 * 1024 * 1024  # [bytes]
_ASSET: Call[Asset] = Call(method="POST", path="/v1/assets", answer=Asset)
POLL_S = 1.0  # interval if the service does not state one
ENDED = ("succeeded", "failed", "canceled")


class Client:
    """Client of a service at a URL. `retries` is the policy for repeatable requests.

    `transport` is an httpx transport; by default the network.
    """

    def __init__(
        self,
        base_url: str = "http://127.0.0.1:8000",
        *,
        api_key: str | None = None,
        timeout_s: float = 60.0,
        retries: Retries | None = None,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        headers = {} if api_key is None else {"Authorization": f"Bearer {api_key}"}
        self._http = httpx.Client(base_url=base_url, headers=headers, timeout=timeout_s, transport=transport)
        self._retries = retries or Retries()

    def __enter__(self) -> Self:
        self._http.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._http.__exit__(kind, error, trace)

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def send(self, call: Call[T]) -> T:
        """Send any operation: `send(operations.get_job(id))`.

        Raises:
            ProblemError: the service refuses the request, or fails.
            UnreachableError: the service cannot be reached.
        """
        return call.read(self._exchange(call.arguments, repeatable=call.repeatable))

    def upload(
        self,
        paths: PathLike | Sequence[PathLike],
        *,
        kind: str | None = None,
        up_axis: str | None = None,
        unit_m: float | None = None,
        height_m: float | None = None,
        resumable: bool | None = None,
    ) -> Asset:
        """Upload a mesh and its companion files, photos, a splat, or a folder. The same files give the same asset.

        `resumable` uploads them in pieces, which survive a broken connection; by default only large files.
        """
        files = chosen_files(paths)
        if sum(file.stat().st_size for file in files) > RESUMABLE_ABOVE if resumable is None else resumable:
            ids = [self.upload_file(file) for file in files]
            request = {"upload_ids": ids, "kind": kind, "up_axis": up_axis, "unit_m": unit_m, "height_m": height_m}
            body = {name: value for name, value in request.items() if value is not None}
            response = self._exchange(lambda: {"method": "POST", "url": "/v1/assets", "json": body}, repeatable=True)
            return _ASSET.read(response)
        lengths = {"unit_m": unit_m, "height_m": height_m}
        given = {"kind": kind, "up_axis": up_axis} | {n: None if v is None else repr(v) for n, v in lengths.items()}
        fields = {name: value for name, value in given.items() if value is not None}
        with ExitStack() as stack:
            response = self._exchange(lambda: _ASSET.arguments() | form_of(files, fields, stack), repeatable=True)
        return _ASSET.read(response)

    def upload_file(self, path: PathLike) -> str:
        """Upload one file by the tus protocol 1.0 and return the upload's id. A broken connection loses one piece."""
        path = Path(path)
        size = path.stat().st_size
        begin = {"method": "POST", "url": "/v1/uploads", "headers": upload_headers(path)}
        begun = self._exchange(lambda: begin, repeatable=True)
        place, offset, attempt = begun.headers["Location"], 0, 1
        with path.open("rb") as stream:
            while offset < size:
                stream.seek(offset)
                piece = stream.read(PIECE)
                outcome: httpx.Response | httpx.TransportError
                try:
                    outcome = self._http.patch(place, content=piece, headers=piece_headers(offset))
                except httpx.TransportError as error:
                    outcome = error
                if isinstance(outcome, httpx.Response) and not outcome.is_error:
                    offset, attempt = int(outcome.headers["Upload-Offset"]), 1
                    continue
                if not isinstance(outcome, httpx.Response) or outcome.status_code not in OUT_OF_STEP:
                    self._pause(attempt, outcome, repeatable=True)
                elif attempt >= self._retries.attempts:
                    raise problem_of(outcome)
                attempt += 1
                stands = self._exchange(lambda: {"method": "HEAD", "url": place, "headers": TUS}, repeatable=True)
                offset = int(stands.headers["Upload-Offset"])
        return str(place).rsplit("/", 1)[1]

    def animate(
        self,
        source: Asset | PathLike,
        params: AnimateParams | None = None,
        *,
        seed: int = 0,
        preset: str = "small",
    ) -> Job:
        """Create a job for the motion of an asset, or of files that are uploaded first."""
        asset = source if isinstance(source, Asset) else self.upload(source)
        request = AnimateRequest(
            type="animate", asset_id=asset.id, params=params or AnimateParams(), seed=seed, preset=preset
        )
        return self.create_job(request)

    def create_job(self, request: Any, *, key: str | None = None) -> Job:
        """Create a job; the request is repeated with the same key if the answer is lost.

        With your own key, repeats within a day return the same job, also from another process.
        """
        call = operations.create_job(request, idempotency_key=key or uuid4().hex)
        job = self.send(call)
        assert isinstance(job, Job)  # the response is an estimate only on request
        return job

    def wait(
        self, job: Job | str, *, timeout_s: float | None = None, on_progress: Callable[[Job], None] | None = None
    ) -> Job:
        """Poll a job until it has ended, at the interval that the service asks for; `on_progress` gets every answer.

        Raises:
            JobEndedError: the job did not succeed.
            WaitTimeoutError: the job has not ended within `timeout_s`.
        """
        call = operations.get_job(job if isinstance(job, str) else job.id)
        give_up = time.monotonic() + (float("inf") if timeout_s is None else timeout_s)
        while True:
            response = self._exchange(call.arguments, repeatable=True)
            now = call.read(response)
            if on_progress is not None:
                on_progress(now)
            if now.state in ENDED:
                break
            pause_s = retry_after_s(response)
            pause = POLL_S if pause_s is None else pause_s
            if time.monotonic() + pause > give_up:
                raise WaitTimeoutError(f"job {now.id} is {now.state} after {timeout_s} s; it goes on")
            time.sleep(pause)
        if now.state != "succeeded":
            raise JobEndedError(now)
        return now

    def artifacts(self, job: Job | str) -> list[Artifact]:
        """List the files that a job has produced so far."""
        manifest = self.send(operations.list_artifacts(job if isinstance(job, str) else job.id))
        return manifest.artifacts

    def download(self, artifact: Artifact, path: PathLike) -> Path:
        """Download a file, resume an interrupted download, and verify the hash.

        Raises:
            IntegrityError: its bytes differ from those that the service announced.
        """
        path = Path(path)
        part = path.with_name(f"{path.name}.part")
        attempt = 1
        while (there := bytes_there(part, artifact)) < artifact.bytes or not part.exists():
            try:
                outcome: httpx.Response | httpx.TransportError = self._fetch_rest(artifact, part, there)
                if isinstance(outcome, httpx.Response) and not outcome.is_error:
                    break
            except httpx.TransportError as error:
                outcome = error
            attempt = 1 if bytes_there(part, artifact) > there else attempt
            self._pause(attempt, outcome, repeatable=True)
            attempt += 1
        return finish(part, artifact, path)

    def download_all(self, job: Job | str, folder: PathLike, *, names: Iterable[str] | None = None) -> dict[str, Path]:
        """Download all files of a job, or the named ones, into a folder; return their paths by name."""
        wanted = None if names is None else set(names)
        Path(folder).mkdir(parents=True, exist_ok=True)
        return {
            artifact.name: self.download(artifact, place_of(artifact, Path(folder)))
            for artifact in self.artifacts(job)
            if wanted is None or artifact.name in wanted
        }

    def interact(self, request: InteractRequest) -> Interact:
        """Push a tree, and return the coordinates of its modes."""
        answer = self.send(operations.interact(request, accept="application/json"))
        assert isinstance(answer, Interact)
        return answer

    def modes(self, spectrum_id: str) -> bytes:
        """Return a spectrum's modes as a safetensors file."""
        return self.send(operations.get_modes(spectrum_id))

    def _exchange(self, arguments: Callable[[], dict[str, Any]], *, repeatable: bool) -> httpx.Response:
        attempt = 1
        while True:
            outcome: httpx.Response | httpx.TransportError
            try:
                outcome = self._http.request(**arguments())
            except httpx.TransportError as error:
                outcome = error
            if isinstance(outcome, httpx.Response) and not outcome.is_error:
                return outcome
            self._pause(attempt, outcome, repeatable=repeatable)
            attempt += 1

    def _pause(self, attempt: int, outcome: httpx.Response | httpx.TransportError, *, repeatable: bool) -> None:
        """Wait before the next attempt, or raise if there is none."""
        wait_s = self._retries.wait_s(attempt, outcome, repeatable=repeatable)
        if wait_s is not None:
            time.sleep(wait_s)
        elif isinstance(outcome, httpx.Response):
            raise problem_of(outcome)
        else:
            why = str(outcome) or type(outcome).__name__
            detail = f"{self._http.base_url} cannot be reached: {why}; look whether the service runs at this address"
            raise UnreachableError(detail) from outcome

    def _fetch_rest(self, artifact: Artifact, part: Path, there: int) -> httpx.Response:
        """Append the missing bytes to `part`. The body of a response without error has been written completely."""
        headers = {"Accept-Encoding": "identity"}  # ranges and hashes count unencoded bytes
        if there:
            headers |= {"Range": f"bytes={there}-", "If-Range": f'"{artifact.sha256}"'}
        with self._http.stream("GET", artifact.url, headers=headers) as response:
            if response.is_error:
                response.read()
                return response
            with part.open("ab" if response.status_code == 206 else "wb") as stream:
                for chunk in response.iter_raw():
                    stream.write(chunk)
            return response
