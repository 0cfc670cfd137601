"""The participant's and the experimenter's page, served on this machine only.

Each page has its own secret in its address: whoever knows the participant's cannot see methods or steer the session.
Requests from other origins or under other host names are refused, and no file outside this package's pages is answered.
"""

from __future__ import annotations

import secrets
import tomllib
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from ..errors import DataError, ForearmError, MissingExtra, ScenarioError
from ..ports import Port
from .session import Given, Session

LANGUAGES = ("en", "de", "nl")


@dataclass(frozen=True)
class Secrets:
    """The two pages' keys, new for each sitting."""

    participant: str = field(default_factory=lambda: secrets.token_urlsafe(12))
    experimenter: str = field(default_factory=lambda: secrets.token_urlsafe(12))


def texts(language: str, base: Path) -> Mapping[str, str]:
    """Texts of the participant's page: a language that comes with the program, or a TOML file; English fills gaps.

    ScenarioError where the file is missing, malformed, or has a text that is not known.
    """
    known = _language("en")
    if language in LANGUAGES:
        return {**known, **_language(language)}
    file = base / language
    try:
        own = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError):
        raise ScenarioError(
            f"language: '{language}' is neither {', '.join(LANGUAGES)} nor a readable TOML file of texts"
        ) from None
    if unknown := sorted(set(own) - set(known)):
        raise ScenarioError(f"{file}: no text is called '{unknown[0]}'; known are {', '.join(known)}"[:300])
    return {**known, **{k: str(v) for k, v in own.items()}}


def _language(name: str) -> dict[str, str]:
    source = resources.files(__package__).joinpath(f"pages/languages/{name}.toml")
    return tomllib.loads(source.read_text(encoding="utf-8"))


def application(
    session: Session,
    grid: tuple[Port, ...],
    words: Mapping[str, str],
    keys: Secrets,
    *,
    beep: bool,
    hosts: tuple[str, ...],
) -> Any:
    """The web application of one session, for an ASGI server; MissingExtra without starlette."""
    try:
        from starlette.applications import Starlette
        from starlette.concurrency import run_in_threadpool
        from starlette.middleware import Middleware
        from starlette.middleware.trustedhost import TrustedHostMiddleware
        from starlette.requests import Request
        from starlette.responses import HTMLResponse, JSONResponse, Response
        from starlette.routing import Route
    except ImportError:
        raise MissingExtra("starlette", "study", "the participant's page") from None

    def page(name: str) -> Callable[[Request], Awaitable[Response]]:
        text = resources.files(__package__).joinpath(f"pages/{name}.html").read_text(encoding="utf-8")

        async def answer(request: Request) -> Response:
            allowed = {"participant": keys.participant, "experimenter": keys.experimenter}[name]
            if not secrets.compare_digest(request.path_params["key"], allowed):
                return Response("not found", 404)
            return HTMLResponse(text, headers=_HEADERS)

        return answer

    async def setup(request: Request) -> Response:
        return JSONResponse(
            {
                "words": dict(words),
                "beep": beep,
                "grid": [{"name": p.name, "x": p.position[0], "y": p.position[1]} for p in grid],
            },
            headers=_HEADERS,
        )

    async def state(request: Request) -> Response:
        view = session.view()
        if request.path_params["key"] == keys.experimenter:
            trial = session.current
            view |= {"participant": session.participant, "task": session.task.name,
                     "trial": None if trial is None else {"method": trial.method, "target": trial.target}}  # fmt: skip
        else:
            view["problem"] = bool(view["problem"])  # its words may name the method
        return JSONResponse(view, headers=_HEADERS)

    def act(who: frozenset[str], do: Callable[[Mapping[str, Any]], None]) -> Callable[[Request], Awaitable[Response]]:
        async def answer(request: Request) -> Response:
            if request.path_params["key"] not in who:
                return Response("not found", 404)
            if not _same_origin(request.headers.get("origin"), hosts):
                return Response("another origin", 403)
            try:
                body = await request.json() if int(request.headers.get("content-length") or 0) else {}
                if not isinstance(body, dict):
                    raise DataError("expected a JSON object")
                await run_in_threadpool(do, body)
            except ForearmError as problem:
                return JSONResponse({"problem": str(problem)}, 409, headers=_HEADERS)
            except (ValueError, TypeError, KeyError):
                return JSONResponse({"problem": "the answer is not readable"}, 400, headers=_HEADERS)
            return JSONResponse(session.view() | {"problem": ""}, headers=_HEADERS)

        return answer

    both = frozenset({keys.participant, keys.experimenter})
    leader = frozenset({keys.experimenter})
    subject = frozenset({keys.participant})
    routes = [
        Route("/p/{key}", page("participant")),
        Route("/e/{key}", page("experimenter")),
        Route("/api/{key}/setup", _guarded(setup, both)),
        Route("/api/{key}/state", _guarded(state, both)),
        Route("/api/{key}/start", act(both, lambda _: session.start()), methods=["POST"]),
        Route("/api/{key}/present", act(subject, lambda _: session.present()), methods=["POST"]),
        Route("/api/{key}/answer", act(subject, lambda body: session.answer(given(body))), methods=["POST"]),
        Route("/api/{key}/pause", act(leader, lambda _: session.pause()), methods=["POST"]),
        Route("/api/{key}/repeat", act(leader, lambda _: session.repeat()), methods=["POST"]),
    ]
    names = [h.partition(":")[0] for h in hosts]
    return Starlette(routes=routes, middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=names)])


_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        "default-src 'self'; img-src data:; script-src 'unsafe-inline'; style-src 'unsafe-inline'"
    ),
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
}


def _guarded(endpoint: Callable[[Any], Awaitable[Any]], who: frozenset[str]) -> Callable[[Any], Awaitable[Any]]:
    from starlette.responses import Response

    async def answer(request: Any) -> Any:
        return await endpoint(request) if request.path_params["key"] in who else Response("not found", 404)

    return answer


def _same_origin(origin: str | None, hosts: tuple[str, ...]) -> bool:
    """A browser names the origin of every POST; programs on this machine may leave it out."""
    return origin is None or origin in {f"http://{h}" for h in hosts}


def given(body: Mapping[str, Any]) -> Given:
    """An answer from JSON: ``points`` (names), ``yes`` (true or false), ``interval`` ("first" or "second") or
    ``outline`` ([[x, y], ...] in metres), and ``answered``, how many trials were over when the page asked."""
    import numpy as np

    seen = None if body.get("answered") is None else int(body["answered"])
    if "yes" in body:
        return Given(yes=bool(body["yes"]), answered=seen)
    if "interval" in body:
        return Given(interval=str(body["interval"]), answered=seen)
    if "outline" in body:
        return Given(strokes=np.asarray(body["outline"], dtype=float), answered=seen)
    points = body["points"]
    if not isinstance(points, list) or len(points) > 1000:
        raise DataError("points: expected a list of grid points")
    return Given(points=tuple(str(p) for p in points), answered=seen)


def serve(
    session: Session, grid: tuple[Port, ...], words: Mapping[str, str], *, beep: bool, host: str = "127.0.0.1",
    port: int = 0, announce: Callable[[str, str], None], stop: Callable[[], bool] | None = None,
) -> None:  # fmt: skip
    """Serve both pages until the session is over and ``stop()`` is true, or Ctrl-C; ``announce`` gets their addresses.

    ``host`` other than this machine's own address must be asked for; port 0 takes a free one. HardwareError-like
    failures of the device appear on the experimenter's page. Raises DataError where the port is taken.
    """
    import asyncio
    import socket

    try:
        import uvicorn
    except ImportError:
        raise MissingExtra("uvicorn", "study", "the participant's page") from None
    keys, listening = Secrets(), socket.socket()
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((host, port))
        listening.listen()  # before the addresses are told: an early browser then waits instead of being refused
    except OSError as problem:
        listening.close()
        raise DataError(
            f"--port {port}: cannot be used ({problem.strerror}); take another, or 0 for a free one"
        ) from None
    number = listening.getsockname()[1]
    hosts = tuple(f"{name}:{number}" for name in dict.fromkeys((host, "127.0.0.1", "localhost")))
    app = application(session, grid, words, keys, beep=beep, hosts=hosts)
    server = uvicorn.Server(uvicorn.Config(app, log_level="error", lifespan="off", access_log=False))
    announce(f"http://{host}:{number}/p/{keys.participant}", f"http://{host}:{number}/e/{keys.experimenter}")

    async def run() -> None:
        serving = asyncio.create_task(server.serve(sockets=[listening]))
        while not serving.done():
            await asyncio.sleep(0.2)
            if stop is not None and stop():
                server.should_exit = True
        await serving

    asyncio.run(run())
