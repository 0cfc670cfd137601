"""The pages' server: who may see and do what. The pages themselves are tried in a browser below."""

from __future__ import annotations

import contextlib
import shutil
import socket
import threading
import time
import urllib.error
import urllib.request
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from test_rendering import waves
from test_study_session import GRID, opened, silent, small

from forearm_fem.errors import DataError, ScenarioError
from forearm_fem.ports import Port
from forearm_fem.results.files import write_transfer
from forearm_fem.study.handover import answers, export
from forearm_fem.study.plan import trials
from forearm_fem.study.run import Prepared
from forearm_fem.study.server import Secrets, addresses, application, serve, texts
from forearm_fem.study.session import Presented, Session
from forearm_fem.study.store import StudyStore

pytest.importorskip("starlette")
pytest.importorskip("httpx2")
HOST = "127.0.0.1:8000"
KEYS = Secrets("them", "us")


@pytest.fixture
def session(tmp_path):
    return opened(tmp_path, small())


@pytest.fixture
def client(session):
    from starlette.testclient import TestClient

    app = application(session, GRID, texts("en", None), KEYS, beep=False, hosts=(HOST,))
    return TestClient(app, base_url=f"http://{HOST}")


def test_a_trial_through_the_server_is_on_disk(client, session):
    client.post("/api/them/start")
    client.post("/api/them/present")
    reply = client.post("/api/them/answer", json={"points": ["5"]})
    assert reply.status_code == 200
    assert reply.json()["answered"] == 1
    assert session._store.answers("01", "places")[0]["response"] == "5"


def test_the_participant_is_blind_and_cannot_steer(client):
    client.post("/api/them/start")
    for text in (client.get("/api/them/state").text, client.get("/api/them/setup").text):
        assert "funneling" not in text
        assert "target" not in text
    assert client.get("/api/us/state").json()["trial"]["method"] == "funneling"
    for what in ("pause", "repeat"):
        assert client.post(f"/api/them/{what}").status_code == 404
    for what in ("present", "answer"):
        assert client.post(f"/api/us/{what}", json={}).status_code == 404
    assert client.get("/e/them").status_code == 404


def test_strangers_get_nothing(client):
    """Another origin, another host name, a guessed key, a path outside the pages."""
    assert client.post("/api/them/start", headers={"Origin": "http://evil.example"}).status_code == 403
    assert client.post("/api/them/start", headers={"Origin": f"http://{HOST}"}).status_code == 200
    assert client.get("/api/them/state", headers={"Host": "evil.example"}).status_code == 400
    assert client.get("/api/guess/state").status_code == 404
    for path in ("/", "/etc/passwd", "/p/../../etc/passwd", "/p/them/../server.py", "/pages/participant.html"):
        assert client.get(path).status_code in (404, 405)


@pytest.mark.parametrize("body", [b"{", b"[]", b'{"points": 3}', b"{}", b'{"points": ["99"]}'])
def test_unreadable_answers_are_refused_in_a_sentence(client, session, body):
    client.post("/api/them/start")
    client.post("/api/them/present")
    reply = client.post("/api/them/answer", content=body)
    assert reply.status_code in (400, 409)
    assert reply.json()["problem"]
    assert session._store.answers("01", "places") == []


def test_two_browsers_cannot_answer_one_trial_twice(client, session):
    client.post("/api/them/start")
    client.post("/api/them/present")
    assert client.post("/api/them/answer", json={"points": ["5"]}).status_code == 200
    assert client.post("/api/them/answer", json={"points": ["5"]}).status_code == 409
    assert len(session._store.answers("01", "places")) == 1


def test_an_answer_from_a_page_out_of_date_is_not_taken_for_the_next_trial(client, session):
    """A second window still shows trial 1 while trial 2 waits for its answer."""
    for k in range(2):
        client.post("/api/them/start")
        client.post("/api/them/present")
        if k == 0:
            assert client.post("/api/them/answer", json={"points": ["5"], "answered": 0}).status_code == 200
    late = client.post("/api/them/answer", json={"points": ["1"], "answered": 0})
    assert late.status_code == 409
    assert "was to trial 1, which is over" in late.json()["problem"]
    assert client.post("/api/them/answer", json={"points": ["9"], "answered": 1}).status_code == 200
    assert [r["response"] for r in session._store.answers("01", "places")] == ["5", "9"]


def test_languages_and_own_texts(tmp_path):
    assert set(texts("de", tmp_path)) == set(texts("en", tmp_path)) == set(texts("nl", tmp_path))
    (tmp_path / "own.toml").write_text('begin = "Go!"')
    assert texts("own.toml", tmp_path)["begin"] == "Go!"
    (tmp_path / "bad.toml").write_text('begn = "Go!"')
    with pytest.raises(ScenarioError, match="no text is called 'begn'"):
        texts("bad.toml", tmp_path)
    with pytest.raises(ScenarioError, match="neither en, de, nl nor"):
        texts("fr", tmp_path)


@contextlib.contextmanager
def served(session, grid=GRID, **options):
    """The pages' addresses while they are served in a thread."""
    pytest.importorskip("uvicorn")
    addresses, stop = [], threading.Event()
    options = {"beep": False, **options}

    def run():
        serve(
            session, grid, texts("en", None), announce=lambda *both: addresses.append(both), stop=stop.is_set, **options
        )

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    deadline = time.monotonic() + 30
    while not addresses and time.monotonic() < deadline:
        time.sleep(0.02)
    try:
        yield addresses[0]
    finally:
        stop.set()
        thread.join(10)


def test_only_this_machine_can_reach_the_page(session):
    """The socket listens on the loopback address alone: this machine's other address refuses."""
    with served(session) as (theirs, _):
        assert urllib.request.urlopen(theirs, timeout=20).status == 200
        port = int(theirs.split(":")[2].split("/")[0])
        own = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)}
        for address in own - {"127.0.0.1", "127.0.1.1"}:
            with pytest.raises(OSError, match=r"refused|unreachable|timed out"):
                socket.create_connection((address, port), timeout=2)
        with pytest.raises(DataError, match=f"--port {port}: cannot be used"):
            serve(session, GRID, texts("en", None), beep=False, port=port, announce=lambda *_: None)


def _page(browser, address):
    page = browser.new_page(viewport={"width": 900, "height": 700})
    problems = []
    page.on("pageerror", lambda e: problems.append(str(e)))
    page.on("console", lambda m: problems.append(m.text) if m.type == "error" else None)
    page.goto(address)
    if "/p/" in address:
        page.locator("body[data-waiting]").wait_for()
    return page, problems


@pytest.mark.slow  # 8 s of a person's keys and clicks
def test_a_whole_session_in_a_browser(browser, tmp_path):
    """One participant from consent to thanks, by keys and clicks: the space bar agrees to nothing, wrong keys answer
    nothing, a second window answers no trial twice, the experimenter pauses, a page closed in the middle goes on at a
    telephone's width with the whole frame between head and foot."""
    store = StudyStore.open(tmp_path, plan := small(("1", "9")))
    store.enrol("01", invited=True)
    text = "You may stop at any time.\nNothing hurts."
    session = Session(store, "01", plan.tasks[0], GRID, silent, consent=text)
    order = trials(plan, plan.tasks[0], 1)
    with served(session) as (theirs, ours):
        page, problems = _page(browser, theirs)
        page.get_by_text("You may stop at any time.").wait_for()
        page.keyboard.press("Space")
        assert not store.consented("01")
        page.locator("#go").click()
        page.locator("body[data-waiting='start']").wait_for()
        assert store.consented("01")
        page.keyboard.press("Space")
        page.locator("#arm").wait_for(state="visible")
        for key in ("x", "0", "Escape", "Enter"):
            page.keyboard.press(key)
        assert (session.view()["waiting"], session.view()["answered"]) == ("answer", 0)
        other, more = _page(browser, theirs)
        other.locator("#arm").wait_for(state="visible")
        lead, most = _page(browser, ours)
        lead.get_by_text(order[0].method).wait_for(state="attached")
        lead.locator("#pause").click()
        page.get_by_text("Paused").wait_for()
        lead.locator("#start").click()
        page.locator("#arm").wait_for(state="visible")
        page.keyboard.press(order[0].target)
        other.keyboard.press("3")
        page.locator("body[data-answered='1']").wait_for()
        other.locator("body:not([data-answered='0'])").wait_for()
        for each in (page, other, lead):
            each.close()
        page, last = _page(browser, theirs)
        page.set_viewport_size({"width": 360, "height": 420})
        for k, trial in enumerate(order[1:], start=1):
            if session.view()["waiting"] == "break":
                page.locator("#go").click()
            page.locator("#arm").wait_for(state="visible")
            box, head, foot = (page.locator(what).bounding_box() for what in ("#arm rect.skin", "header", "footer"))
            assert head["y"] + head["height"] <= box["y"] < box["y"] + box["height"] <= foot["y"]
            assert 0 <= box["x"] < box["x"] + box["width"] <= 360
            if k % 2:
                page.locator(f"#arm g[data-name='{trial.target}']").click()
            else:
                page.keyboard.press(trial.target)
            page.locator(f"body[data-answered='{k + 1}']").wait_for()
        page.locator("body[data-waiting='done']").wait_for()
        assert [p for p in (*problems, *more, *most, *last) if "409" not in p] == []  # a refusal is logged as an error
        page.close()
    rows = store.answers("01", "places")
    assert [r["trial"] for r in rows] == [str(t.number) for t in order]
    assert [r["response"] for r in rows][1:] == [t.target for t in order[1:]]
    assert rows[0]["response"] in (order[0].target, "3")
    assert rows[0]["presentations"] == "2"


@pytest.mark.slow
def test_several_points_in_a_browser(browser, tmp_path):
    several = opened(tmp_path / "a", small(answer="several points"))
    with served(several) as (theirs, _):
        page, problems = _page(browser, theirs)
        page.keyboard.press("Space")
        page.locator("#arm").wait_for(state="visible")
        for key in ("4", "5", "6", "6"):
            page.keyboard.press(key)
        page.keyboard.press("Enter")
        page.locator("body[data-answered='1']").wait_for()
        assert problems == []
        page.close()
    assert several._store.answers("01", "places")[0]["response"] == "4 5"


@pytest.mark.slow
def test_a_digit_that_begins_other_names_is_no_answer(browser, tmp_path):
    """Of twelve points, 1 would be the answer of who types 12; 5 begins no other name."""
    twelve = (*GRID, *(Port(str(n), "point", (0.02, 0.01 * (n - 11), 0.0)) for n in (10, 11, 12)))
    store = StudyStore.open(tmp_path, plan := small())
    store.enrol("01", consent="2026-11-24")
    session = Session(store, "01", plan.tasks[0], twelve, silent)
    with served(session, twelve) as (theirs, _):
        page, problems = _page(browser, theirs)
        page.keyboard.press("Space")
        page.locator("#arm").wait_for(state="visible")
        page.keyboard.press("1")
        page.keyboard.press("5")
        page.locator("body[data-answered='1']").wait_for()
        page.locator("#arm").wait_for(state="visible")
        page.locator("#arm g[data-name='12']").click()
        page.locator("body[data-answered='2']").wait_for()
        assert problems == []
        page.close()
    assert [r["response"] for r in store.answers("01", "places")] == ["5", "12"]


@pytest.mark.slow
def test_a_key_while_the_stimulus_plays_does_nothing(browser, tmp_path):
    over = threading.Event()

    def player(method, target):
        over.wait(30)
        return Presented(0.2, 1.0)

    session = opened(tmp_path, small(), player)
    with served(session) as (theirs, _):
        page, problems = _page(browser, theirs)
        page.keyboard.press("Space")
        while session.view()["waiting"] != "playing":
            time.sleep(0.02)
        page.keyboard.press("5")
        assert session.view()["answered"] == 0
        over.set()
        page.locator("#arm").wait_for(state="visible")
        assert session.view()["answered"] == 0
        page.keyboard.press("9")
        page.locator("body[data-answered='1']").wait_for()
        assert problems == []
        page.close()
    assert session._store.answers("01", "places")[0]["response"] == "9"


def _status(address, **headers):
    """Of a GET, or of a POST where an origin is named."""
    asked = urllib.request.Request(address, b"" if "Origin" in headers else None, headers)
    try:
        with urllib.request.urlopen(asked, timeout=20) as reply:
            return reply.status
    except urllib.error.HTTPError as refused:
        with refused:
            return refused.code


def test_other_machines_reach_the_page_where_asked_for_and_strangers_nothing(session):
    """By this machine's own address; under another host name or without the secret there is nothing, even so."""
    with served(session, host="0.0.0.0") as (theirs, _):
        host, port = theirs.split("/")[2].split(":")
        start = theirs.replace("/p/", "/api/") + "/start"
        assert host == addresses("0.0.0.0")[0]
        for at in {host, "127.0.0.1"}:
            assert _status(theirs.replace(host, at)) == 200
            assert _status(start.replace(host, at), Origin=f"http://{at}:{port}") == 200
        assert _status(theirs, Host="evil.example") == 400
        assert _status(theirs.rpartition("/")[0] + "/guess") == 404
        assert _status(start, Origin="http://evil.example") == 403


JSPSYCH = Path(__file__).parents[1] / "node_modules" / "jspsych"


@pytest.mark.skipif(not JSPSYCH.exists(), reason="needs jsPsych beside the package: npm install --no-save jspsych@8")
def test_the_jspsych_example_plays_an_exported_folder_and_its_answers_are_read(browser, tmp_path):
    """The page as it is exported, served by python -m http.server: every trial of a task by keys and clicks, the file
    that it downloads, and the same answers in our table."""
    write_transfer(tmp_path / "g.nc", waves(np.arange(10.0, 500.1, 5.0)))
    (tmp_path / "flat.toml").write_text("name = 'flat'\n[sweep]\nsample_rate = 5000.0\nduration = 0.2\n")
    (tmp_path / "pilot.toml").write_text(
        "name = 'pilot'\nscenario = 'flat.toml'\ntransfer = 'g.nc'\n[stimuli]\nlead = 0.05\ntail = 0.09\npeak = 0.1\n"
        "methods = ['funneling', 'combination']\ntargets = ['1', '5']\n[[tasks]]\nname = 'places'\nrepetitions = 2\n"
        "blocks = 2\ntraining = 0\nanswer = 'several points'\nbreak_seconds = 0\n[order]\nno_target_twice = false\n"
    )
    prepared = Prepared.of(tmp_path / "pilot.toml")
    folder = export(prepared, "01", prepared.made("01"), rate=48000.0, full_scale=10.0)
    shutil.copy(JSPSYCH / "dist" / "index.browser.min.js", folder / "jspsych.js")
    shutil.copy(JSPSYCH / "css" / "jspsych.css", folder / "jspsych.css")
    quiet = type("Quiet", (SimpleHTTPRequestHandler,), {"log_message": lambda *_: None})
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(quiet, directory=folder)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        page, problems = browser.new_page(), []
        page.on("pageerror", lambda e: problems.append(str(e)))
        address = f"http://127.0.0.1:{server.server_port}/jspsych_study.html?task=places"
        page.goto(address)
        page.get_by_text("The output device has 2 channels, 4 are needed").wait_for()  # of a browser without a card
        page.goto(f"{address}&channels=any")
        page.locator("#go:enabled").click()
        for k in range(8):
            if k == 4:
                page.get_by_text("A break.").wait_for()
                page.locator("#go:enabled").click()
            page.locator("svg").wait_for()
            page.keyboard.press("5")
            if k % 2:
                page.locator("g[data-name='6']").click()
            page.locator("#go").click()
            page.locator("svg").wait_for(state="detached")
        with page.expect_download() as download:
            page.locator("#go:enabled").click()
        download.value.save_as(tmp_path / "answers.json")
        assert problems == []
        page.close()
        server.shutdown()
    table = answers(prepared.store(), [tmp_path / "answers.json"], prepared.grid())["places"]
    assert table["response"].tolist() == 4 * ["5", "5 6"]
    assert table["trial"].tolist() == list(range(1, 9))
    assert table["response_time"].between(0, 60).all()
