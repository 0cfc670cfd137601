"""The participant's and the experimenter's page, served on this machine, or to others where that is asked for.

Each page has its own secret in its address: whoever knows the participant's cannot see methods or steer the session.
Requests from other origins or under other host names are refused, and no file outside this package's pages is answered.
"""

from __future__ import annotations

import asyncio
import secrets
import socket
import tomllib
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

from ..errors import DataError, ForearmError, ScenarioError
from ..ports import Port
from .session import Session

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
    except (OSError, ValueError, RecursionError):
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
    session: Session, grid: tuple[Port, ...], words: Mapping[str, str], keys: Secrets, *, beep: bool,
    hosts: tuple[str, ...], levels: str = "",
) -> Any:  # fmt: skip
    """The web application of one session, for an ASGI server; ``levels`` is what the experimenter is told of them."""
    from starlette.applications import Starlette
    from starlette.concurrency import run_in_threadpool
    from starlette.middleware import Middleware
    from starlette.middleware.trustedhost import TrustedHostMiddleware
    from starlette.responses import HTMLResponse, JSONResponse, Response
    from starlette.routing import Route

    points = [{"name": p.name, "x": p.position[0], "y": p.position[1]} for p in grid]
    scene = {"words": dict(words), "beep": beep, "consent": session.consent_text, "grid": points}
    leader, subject, both = {keys.experimenter}, {keys.participant}, {keys.experimenter, keys.participant}
    shown: Mapping[str, tuple[set[str], Callable[[Any], Any]]] = {
        "/p/{key}": (subject, lambda _: _page("participant")),
        "/e/{key}": (leader, lambda _: _page("experimenter")),
        "/api/{key}/setup": (both, lambda _: scene),
        "/api/{key}/state": (both, lambda key: _state(session, levels, led=key == keys.experimenter)),
    }
    done: Mapping[str, tuple[set[str], Callable[[Any], Any]]] = {
        "/api/{key}/consent": (subject, lambda _: session.consent()),
        "/api/{key}/start": (both, lambda _: session.start()),
        "/api/{key}/present": (subject, lambda _: session.present()),
        "/api/{key}/answer": (subject, lambda body: session.answer(*_given(body))),
        "/api/{key}/pause": (leader, lambda _: session.pause()),
        "/api/{key}/repeat": (leader, lambda _: session.repeat()),
    }

    async def answer(request: Any, who: set[str], what: Callable[[Any], Any]) -> Any:
        """Show or do what is asked by whose key it is; refusals in words, and nothing for anybody else."""
        key = str(request.path_params["key"])
        if not any([secrets.compare_digest(key.encode(), own.encode()) for own in who]):
            return Response("not found", 404)
        if request.method != "POST":
            found = what(key)
            return (HTMLResponse if isinstance(found, str) else JSONResponse)(found, headers=_HEADERS)
        origin = request.headers.get("origin")  # browsers name it at every POST, programs on this machine need not
        if origin is not None and origin not in {f"http://{h}" for h in hosts}:
            return Response("another origin", 403)
        try:
            body = await request.json() if int(request.headers.get("content-length") or 0) else {}
            if not isinstance(body, dict):
                raise DataError("expected a JSON object")
            await run_in_threadpool(what, body)
        except ForearmError as problem:
            return JSONResponse({"problem": str(problem)}, 409, headers=_HEADERS)
        except (ValueError, TypeError, KeyError):
            return JSONResponse({"problem": "the answer is not readable"}, 400, headers=_HEADERS)
        return JSONResponse(session.view() | {"problem": ""}, headers=_HEADERS)

    routes = [
        Route(path, partial(answer, who=who, what=what), methods=[method])
        for method, asked in (("GET", shown), ("POST", done)) for path, (who, what) in asked.items()
    ]  # fmt: skip
    names = [h.partition(":")[0] for h in hosts]
    return Starlette(routes=routes, middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=names)])


def _page(name: str) -> str:
    return resources.files(__package__).joinpath(f"pages/{name}.html").read_text(encoding="utf-8")


def _state(session: Session, levels: str, *, led: bool) -> dict[str, Any]:
    """State of the session, for the experimenter who leads it, or for the participant."""
    view = session.view()
    if not led:
        return view | {"problem": bool(view["problem"])}  # its words may name the method
    trial = session.current
    shown = None if trial is None else {"method": trial.method, "target": trial.target}
    return view | {"participant": session.participant, "task": session.task.name, "trial": shown, "levels": levels}


_INLINE = "script-src 'unsafe-inline'; style-src 'unsafe-inline'"
_HEADERS = {
    "Content-Security-Policy": f"default-src 'self'; img-src data:; {_INLINE}",
    "Cache-Control": "no-store", "X-Frame-Options": "DENY", "Referrer-Policy": "no-referrer",
}  # fmt: skip


def _given(body: Mapping[str, Any]) -> tuple[tuple[str, ...], int | None]:
    """Names of ``points`` from JSON, and ``answered``, how many trials were over when the page asked."""
    points, answered = body["points"], body.get("answered")
    if not isinstance(points, list) or len(points) > 1000:
        raise DataError("points: expected a list of grid points")
    return tuple(str(p) for p in points), None if answered is None else int(answered)


def addresses(host: str) -> tuple[str, ...]:
    """Names under which pages bound to ``host`` are reached, first one that other machines can use if any can."""
    if host not in ("0.0.0.0", ""):
        return (host,)
    own = [str(info[4][0]) for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, suppress(OSError):
        probe.connect(("192.0.2.1", 9))  # asks the routing table; sends nothing
        own.insert(0, str(probe.getsockname()[0]))
    others = [a for a in own if not a.startswith("127.")]
    return tuple(dict.fromkeys((*others, socket.gethostname().lower(), *own)))


def serve(
    session: Session, grid: tuple[Port, ...], words: Mapping[str, str], *, beep: bool, host: str = "127.0.0.1",
    port: int = 0, levels: str = "", announce: Callable[[str, str], None], stop: Callable[[], bool] | None = None,
) -> None:  # fmt: skip
    """Serve both pages until the session is over and ``stop()`` is true, or Ctrl-C; ``announce`` gets their addresses.

    ``host`` other than the loopback address opens the pages to machines that reach it (0.0.0.0: on every network);
    announced are then addresses that others can use. Port 0 takes a free one. Failures of the device appear on the
    experimenter's page. Raises DataError where host or port cannot be used.
    """
    import uvicorn

    keys, listening = Secrets(), socket.socket()
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((host, port))
        listening.listen()  # before the addresses are told: an early browser then waits instead of being refused
    except OSError as problem:
        listening.close()
        raise DataError(
            f"--host {host} --port {port}: cannot be used ({problem.strerror}); take other ones, port 0 for a free one"
        ) from None
    number = listening.getsockname()[1]
    names = addresses(host)
    hosts = tuple(f"{name}:{number}" for name in dict.fromkeys((*names, "127.0.0.1", "localhost")))
    app = application(session, grid, words, keys, beep=beep, hosts=hosts, levels=levels)
    server = uvicorn.Server(uvicorn.Config(app, log_level="error", lifespan="off", access_log=False))
    at = f"http://{names[0]}:{number}"
    announce(f"{at}/p/{keys.participant}", f"{at}/e/{keys.experimenter}")

    async def run() -> None:
        """Serve until a stop is asked for."""
        serving = asyncio.create_task(server.serve(sockets=[listening]))
        while not serving.done():
            await asyncio.sleep(0.2)
            if stop is not None and stop():
                server.should_exit = True
        await serving

    asyncio.run(run())
