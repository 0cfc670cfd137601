"""The page of a validation: what the prediction is for, where it fails, what was measured and what arms would show."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from .page import Block, Page, Section

_NAMES = {"all": "all laws", "kelvin-voigt": "Kelvin-Voigt", "zener": "standard linear solid", "springpot": "springpot"}
_READINGS = {"window": "over the wavelet's window", "record": "over the whole record"}


def validation_page(data: Mapping[str, Any], scene: str = "thesis") -> Page:
    """The page of what :func:`forearm_fem.questions.predict.validate.validate` found: where it fails first."""
    compared = list(_compared(data))
    inside = sum(t["all"]["inside"] for t in compared)
    measured = _measured(data)
    sections = [
        Section("fails", "Where it fails",
                Block(["outside the band", "measured", "arms, 5-95 %"], _rows(failures(data)))),
        Section("inside", "How many findings lie inside",
                Block(["findings", "inside the band"], _rows(coverage(data)))),
        *([measured] if measured else []),
        Section("next", "What to do next", commands=[
            ("See S of your device on people", f"forearm-fem predict {scene} --set engine=layered"),
            ("Judge a measured G of your own", f"forearm-fem validate {scene} --set engine=layered --measured G.nc"),
        ]),
        Section("purpose", "What it is for", Block(["question", "answer"], _rows(_PURPOSE)),
                ["In the spirit of ASME V&V 40 and the ten rules of credible practice."], folded=True),
        _published(data),
        *_table_one(data),
        _shah(data["shah"]),
        Section("scope", "What is covered, and what is not", bullets=[f"Model: {data['left_out']}.", *_SCOPE],
                folded=True),
    ]  # fmt: skip
    title = f"Validation: {inside} of {len(compared)} published findings lie in the band over arms"
    stamp = f"{data['draws']} arms, seed {data['seed']}, {data['model']} · forearm_fem {data['program']}"
    return Page(title, joint_words(data), sections, stamp)


def _rows(found: Iterable[Sequence[str]]) -> list[list[str]]:
    return [list(row) for row in found]


_PURPOSE = (
    (
        "question of interest",
        "Will four voice coils on a forearm make one of nine points move more than the others, and by which method?",
    ),
    (
        "context of use",
        "Choosing among devices and methods before hardware exists, by an engineer who will measure G before anything "
        "is worn.",
    ),
    (
        "what hangs on it",
        "A wrong choice costs a prototype; nobody is harmed. The band decides nothing about one person: measure G for "
        "that.",
    ),
    (
        "verification",
        "Numerics against closed forms and independent codes: `forearm-fem verify`.",
    ),
    (
        "inputs",
        "Spreads and sources of every input: priors.toml and tissue_laws.json in the package, physics data in the "
        "manual.",
    ),
    ("validation", "This page: relaxed forearms, 50-500 Hz, normal motion."),
    (
        "open to others",
        "One command makes this page from the package alone; seed and draws are kept in `draws.nc`.",
    ),
)
_SCOPE = (
    "Covered: relaxed volar forearms of adults, small motions (linear), normal motion, 10-500 Hz.",
    "Not covered: tense muscle, motion along the skin, wet or taped skin, thresholds of perception.",
    "Applicability: appendix A and Table I are the same device on one participant each; Zhang, Sueda, Sofia and Shah "
    "are other devices on other people, and test the tissue rather than S.",
    "No public G of a forearm with actuators on the skin was found; the next one is the best test there can be.",
)


def verdict(judged: Mapping[str, Any]) -> str:
    """E.g. ``yes`` or ``no, just``."""
    return ("yes" if judged["inside"] else "no") + ("" if judged["sure"] else ", just")


def failures(data: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Findings outside the band: name, measured value, value of the arms."""
    rows = [
        (f"Table I, S {words}: {e['method']} at {_short(e['group'])}", f"{e['measured']:.2f}",
         f"{e['low']:.2f}-{e['high']:.2f}{'' if e['sure'] else ' (just)'}")
        for reading, words in _READINGS.items()
        for e in data["table_one"][reading]["all"]["entries"]
        if not e["inside"]
    ]  # fmt: skip
    outside = (t for t in _compared(data) if not t["all"]["inside"])
    return rows + [
        (f"{t['name']}: {t['what']}{_note(t)}", _measured_cell(t),
         _cell(t, "all") + ("" if t["all"]["sure"] else " (just)"))
        for t in outside
    ]  # fmt: skip


def joint_words(data: Mapping[str, Any]) -> list[str]:
    """Number of Table I's entries outside, their joint distance, and the one that no law explains."""
    lines = []
    if other := data.get("other_device"):
        verb = "is" if len(other) == 1 else "are"
        lines.append(f"The scene's {', '.join(other)} {verb} not the thesis': Table I is of another device or stimulus "
                     "and judges these arms less.")  # fmt: skip
    for reading, words in _READINGS.items():
        every = data["table_one"][reading]["all"]
        out = sum(not e["inside"] for e in every["entries"])
        jointly = "Too few arms to say how far the nine lie jointly." if every["distance"] is None else (
            f"Jointly {_share(every['beyond'])} of the arms lie as far from the middle as the thesis' nine do "
            f"({every['distance']:.1f} times the median distance)."
        )  # fmt: skip
        lines.append(f"Table I, S {words}: {out} of 9 entries lie outside. {jointly}")
    if (found := data["measured"]) is not None:
        lines.append(f"The measured G of {found['name']}: {9 - found['inside']} of 9 entries lie outside.")
    hit: dict[str, bool] = {}  # whether some law and reading has an entry in its band
    for of_law in (f for reading in data["table_one"].values() for f in reading.values()):
        for e in of_law["entries"]:
            key = f"{e['method']} at {_short(e['group'])}"
            hit[key] = hit.get(key, False) or e["inside"]
    never, laws = [key for key, ever in hit.items() if not ever], any(len(f) > 1 for f in data["table_one"].values())
    whose = "In no law's band, whichever the reading" if laws else "In the band of all arms in neither reading"
    lines.append(f"{whose}: {', '.join(never)}." if never else
                 f"Every entry of Table I lies in the band of some {'law and ' if laws else ''}reading.")  # fmt: skip
    return lines


def coverage(data: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Number of findings inside: those that made no prior, those that did, and by source."""
    compared = list(_compared(data))
    groups = {
        "that made no prior": [t for t in compared if not t["fitted"]],
        "that the laws were fitted to": [t for t in compared if t["fitted"]],
        **{g: [t for t in compared if t["group"] == g] for g in dict.fromkeys(t["group"] for t in compared)},
    }
    return [(name, f"{sum(t['all']['inside'] for t in found)} of {len(found)}") for name, found in groups.items()]


def _compared(data: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    return [t for t in data["targets"] if t["kind"] != "not comparable" and t["all"] is not None]


def _short(group: str) -> str:
    return group.partition(" ")[0].lower()


def _share(share: float) -> str:
    return "none" if share == 0 else f"{share:.0%}" if share >= 0.01 else "fewer than 1%"


def _note(target: Mapping[str, Any]) -> str:
    return f" ({target['note']})" if target["note"] else ""


def _measured_cell(target: Mapping[str, Any]) -> str:
    if target["kind"] == "not comparable":
        return "not seen"
    return "shown" if target["kind"] == "trend" else f"{target['measured']:g}{target['spread']} {target['unit']}"


def _cell(target: Mapping[str, Any], which: str) -> str:
    band = target.get(which)
    if target["kind"] == "not comparable":
        return "–"
    if band is None:
        return "too few arms"
    if target["kind"] == "trend":
        return f"{band['share']:.0%} of arms"
    return f"{band['low']:.3g}-{band['high']:.3g}"


def _published(data: Mapping[str, Any]) -> Section:
    header = ["finding", "measured", *_NAMES.values(), "half width, x/÷", "inside", "source"]
    rows = []
    for t in data["targets"]:
        told = "not comparable" if t["kind"] == "not comparable" or t["all"] is None else (
            verdict(t["all"]) + (", fitted" if t["fitted"] else ""))  # fmt: skip
        width = (t.get("all") or {}).get("width")
        rows.append(
            [f"{t['name']}: {t['what']}{_note(t)}", _measured_cell(t), *(_cell(t, k) for k in _NAMES),
             "–" if width is None else f"{width:.2f}", told, t["source"]]
        )  # fmt: skip
    note = (
        "Band: 5-95 % over arms. Half width: half of the band in the logarithm; a wide band says little. A trend is "
        "inside where 5 % of the arms or more show it. Just: other draws of as many arms may say otherwise. Fitted "
        "findings made the tissue laws and are no test of them. Priors and laws were committed before any of these "
        f"comparisons was run. Numerics: {data['numerics']['observables']:.0e} of the largest displacement."
    )
    return Section("published", "Published measurements", Block(header, rows, note), folded=True)


def _table_one(data: Mapping[str, Any]) -> list[Section]:
    """Table I by both readings, since the thesis does not state the time that S is summed over."""
    lost = sum(data["failed"].values())
    left_out = f" {lost} of {data['draws']} arms gave no S and are left out: {'; '.join(data['failed'])}."
    note = (
        "One participant, on the G that was measured: judged by S as the rig of each arm reports it, one sweep an "
        "entry. Deviations are over the four edges, and the four corners. The log score is the logarithm of the arms' "
        "density at the nine means: bands that are wide for no reason lose by it. Bands are of the arms as they are, "
        "so that poor numerics widen none. Just: other draws of as many arms, or the numerics, may say otherwise. "
        "Numerics of the arms' G: e_band "
        f"{data['numerics']['S']:.0e} in the median, {data['numerics']['largest']:.0e} at most. It leaves S a factor "
        f"of {data['numerics']['factor']:.3f} in the median.{left_out if lost else ''}"
    )
    sections = []
    for reading, words in _READINGS.items():
        found = data["table_one"][reading]
        header = ["place", "method", "thesis", *(f"{_NAMES[k]}, 5-95 %" for k in found), "inside"]
        rows = []
        for k, entry in enumerate(found["all"]["entries"]):
            bands = [found[law]["entries"][k] for law in found]
            cells = [f"{b['low']:.2f}-{b['high']:.2f}{'' if b['inside'] else ' (out)'}" for b in bands]
            rows.append([entry["group"], entry["method"], f"{entry['measured']:.2f}", *cells, verdict(entry)])
        few = [name for law, name in _NAMES.items() if law not in found]
        missing = f" Too few arms for a band of its own: {', '.join(few)}." if few else ""
        told = [
            f"{_NAMES[k]}: {f['inside']} of 9 inside, {sum(d['inside'] for d in f['deviations'])} of "
            f"{len(f['deviations'])} deviations, {f['draws']} arms, half width x/÷ {f['width']:.2f}"
            + ("" if f["distance"] is None else f", {_share(f['beyond'])} of the arms further out, joint "
               f"distance {f['distance']:.1f}, log score {f['score']:.1f}")
            for k, f in found.items()
        ]
        sections.append(Section(f"table-one-{reading}", f"Table I of the thesis, S {words}",
                                Block(header, rows, f"{note}{missing}"), bullets=told, folded=True))  # fmt: skip
    return sections


def _shah(subjects: Sequence[Mapping[str, Any]]) -> Section:
    steps = subjects[0]["frequency"]
    header = ["arm", "girth at the source [cm]", "fat [mm]",
              *(f"{f:g} Hz, {place}" for f in steps for place in ("4 cm", "8 cm"))]  # fmt: skip
    rows = [
        [f"{s['subject']} ({s['sex']})", f"{100 * s['circumference'][0]:.1f}", f"{1e3 * s['fat']:.1f}",
         *(f"{s['low'][k][p]:.2g}-{s['high'][k][p]:.2g}" for k in range(len(steps)) for p in (0, 1))]
        for s in subjects
    ]  # fmt: skip
    note = (
        "Acceleration [g], 5-95 % over arms, of a motor with the amplitude that the paper gives. Fat is from sex and "
        "girth (Maughan 1984); girth, taper and bones themselves are not in the model, which is flat. The paper's own "
        "accelerations were not seen, so that nothing is judged here."
    )
    return Section("shah", "The six arms of Shah et al. 2019", Block(header, rows, note), folded=True)


def _measured(data: Mapping[str, Any]) -> Section | None:
    if (found := data["measured"]) is None:
        return None
    ends = [f" ({e['interval'][0]:.2f}-{e['interval'][1]:.2f})" if e["interval"] else "" for e in found["entries"]]
    rows = [[e["group"], e["method"], f"{e['measured']:.2f}{own}", f"{e['low']:.2f}-{e['high']:.2f}", verdict(e)]
            for e, own in zip(found["entries"], ends, strict=True)]  # fmt: skip
    told = (f"G of {found['name']}, at the places that it declares: one measured elsewhere tests this comparison "
            f"and not the arms. {found['inside']} of {len(rows)} inside.")  # fmt: skip
    if found["distance"] is not None:
        told += (f" {_share(found['beyond']).capitalize()} of the arms lie as far out ({found['distance']:.1f} times "
                 "the median distance).")  # fmt: skip
    missed = f" {found['note']}." if found.get("note") else ""
    header = ["place", "method", "this G", "arms, 5-95 %", "inside"]
    return Section("measured", "A measured G through the same comparison", Block(header, rows, f"{told}{missed}"))
