"""A session in the terminal: for labs without a browser, and for trying a study quickly."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ..errors import DataError, ForearmError
from ..ports import Port
from .session import Given, Session


def run_in_terminal(
    session: Session, grid: Sequence[Port], say: Callable[[str], None], ask: Callable[[str], str] = input
) -> None:
    """Present and ask until the task is done; an unreadable answer is asked again, end of input stops.

    Drawings need the page: DataError.
    """
    if session.task.answer == "drawing":
        raise DataError("a drawing needs the page; leave --terminal out")
    names = " ".join(p.name for p in grid)
    prompts = {"one point": f"where ({names})? ", "several points": f"where ({names}; several with spaces)? ",
               "yes or no": "felt (y or n)? ", "first or second": "stronger (1 or 2)? "}  # fmt: skip
    try:
        while (view := session.view())["waiting"] != "done":
            if view["waiting"] in ("start", "pause", "break"):
                ask(f"{view['answered']} of {view['total']}; Enter when ready ")
                _attempt(session.start, say)
            elif view["waiting"] == "stimulus":
                _attempt(session.present, say)
            else:
                text = ask(prompts[session.task.answer]).strip().lower()
                _attempt(lambda text=text: session.answer(_given(session, text)), say)  # type: ignore[misc]
    except EOFError:
        pass
    view = session.view()
    say(f"{view['answered']} of {view['total']} answered")


def _given(session: Session, text: str) -> Given:
    if session.task.answer == "yes or no":
        if text[:1] not in ("y", "n"):
            raise DataError("answer y or n")
        return Given(yes=text.startswith("y"))
    if session.task.answer == "first or second":
        return Given(interval={"1": "first", "2": "second"}.get(text))
    return Given(points=tuple(text.split()))


def _attempt(do: Callable[[], None], say: Callable[[str], None]) -> None:
    try:
        do()
    except ForearmError as problem:
        say(str(problem))
