"""calibrate, convert, compare, fit and the group daq: from a device or a file to G."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import typer

from ..errors import DataError, HardwareError
from ..scenario import Scenario, apply_overrides, load_scenario, scenario_file
from .common import (
    Declared,
    Display,
    OutFolder,
    Overrides,
    ScenarioFile,
    all_hold_g,
    asked_words,
    console,
    declaration,
    declared,
    ends_in,
    holds_g,
    job,
    measured_g,
    noted,
    out_folder,
    print_notes,
    refuse_folder,
    scenario_word,
    scene_of,
    stop_on_ctrl_c,
    there,
    transfer_file,
)
from .simulate import run_of

if TYPE_CHECKING:
    from ..questions.calibrate import CalibrationResult, VirtualSetup


# calibrate, play, loopback, compare, fit: measured G and simulated G beside each other.

DaqChoice = Annotated[
    Literal["virtual", "ni", "sound"],
    typer.Option("--daq", help="virtual: through a G; ni: a cDAQ; sound: a multichannel sound card"),
]
Card = Annotated[str | None, typer.Option("--card", help="sound: name or number of the card; default: the system's")]
Cable = Annotated[
    Path | None,
    typer.Option("--loopback", help="record of `forearm-fem daq loopback`: its latency and gain are taken off",
                 callback=there("no such file; `forearm-fem daq loopback SCENARIO` makes one")),
]  # fmt: skip
Through = Annotated[
    Path | None,
    typer.Option("--through", help="virtual: file or results folder of the G to play through; default: simulated now",
                 callback=holds_g),
]  # fmt: skip
Snr = Annotated[float, typer.Option(help="virtual: strongest response over the sensor's noise, in dB")]
Bits = Annotated[int, typer.Option(min=0, max=32, help="virtual: of the converters; 0 = no quantisation")]
Latency = Annotated[int, typer.Option(min=0, help="virtual: delay of the inputs, in samples")]
Seed = Annotated[int, typer.Option(help="virtual: seed of the noise")]


_NOT_ASKED: Mapping[str, float] = MappingProxyType({"snr": 60.0, "bits": 16, "latency": 0, "seed": 0})


def _refuse_idle(
    daq: str, card: str | None, through: Path | None = None, declare: list[str] | None = None,
    cable: Path | None = None, **virtual: float,
) -> None:  # fmt: skip
    """DataError for an option that the device which was asked for does not look at."""
    if card is not None and daq != "sound":
        raise DataError(f"--card: has no effect with --daq {daq}; leave it out, or give --daq sound")
    if through is not None and daq != "virtual":
        raise DataError(f"--through: has no effect with --daq {daq}, which plays through skin; leave it out")
    if cable is not None and daq == "virtual":
        raise DataError("--loopback: has no effect with --daq virtual, whose latency is known; leave it out")
    idle = [name for name, value in virtual.items() if value != _NOT_ASKED[name]] + ["declare"] * bool(declare)
    if idle and daq != "virtual":
        raise DataError(f"--{idle[0]}: has no effect with --daq {daq}; leave it out, or give --daq virtual")


def calibrate(
    scenario: ScenarioFile,
    overrides: Overrides = None,
    out: OutFolder = None,
    daq: DaqChoice = "virtual",
    through: Through = None,
    declare: Declared = None,
    snr: Snr = 60.0,
    bits: Bits = 16,
    latency: Latency = 0,
    seed: Seed = 0,
    card: Card = None,
    cable: Cable = None,
    yes: Annotated[bool, typer.Option("--yes", help="do not wait for Enter at each point")] = False,
) -> None:
    """Measure G, one actuator and one point at a time; the same command resumes after a stop."""
    from ..measurement.entry import bias_said

    _refuse_idle(daq, card, through, declare, cable, snr=snr, bits=bits, latency=latency, seed=seed)
    asked = load_scenario(scenario, overrides=overrides or ())
    folder = out_folder(out, asked, overrides, "calibration")
    virtual = None
    if daq == "virtual":
        virtual = _virtual(asked, scenario, through, declare, snr, bits, latency, seed, overrides)
    result = _calibrated(asked, folder, daq, virtual, card, cable, ask=daq != "virtual" and not yes)
    findings = result.measured.findings
    for kind in dict.fromkeys(f.kind for f in findings):
        alike = [f.sentence for f in findings if f.kind == kind]
        shown = alike if len(alike) <= _MOST_ALIKE else alike[:1]
        typer.echo("\n".join(shown))
        if len(shown) < len(alike):
            typer.echo(f"also {kind}: {', '.join(sentence.partition(':')[0] for sentence in alike[1:])}")
    if said := bias_said(result.measured):
        print_notes([said])
    valid = result.measured.transfer.valid
    if valid is not None:
        typer.echo(f"entries that may be used: {100 * valid.mean():.0f} %")
    if daq != "virtual":
        typer.echo(f"latency of the device: {result.measured.transfer.provenance['latency_basis']}")
    typer.echo(f"G: {result.transfer_file}")
    again = ["forearm-fem", "render", str(result.transfer_file), "--scenario", scenario_word(scenario)]
    typer.echo(f"next: {shlex.join(again)}")


def _calibrated(
    asked: Scenario, folder: Path, daq: Literal["virtual", "ni", "sound"], virtual: VirtualSetup | None,
    card: str | None, cable: Path | None, *, ask: bool,
) -> CalibrationResult:  # fmt: skip
    from ..measurement.playback import read_loopback
    from ..questions.calibrate import run_calibration

    kept = None if cable is None else read_loopback(cable)

    with job(folder) as display, stop_on_ctrl_c() as stop:

        def operator(where: str) -> bool:
            """True if it is to be measured there: waits for Enter where an operator is to be asked."""
            if not ask:
                return True
            console.print(f"{where}; Enter to measure, q to stop", highlight=False)
            stop.waiting = True
            try:
                return input().strip().lower() != "q"
            except EOFError:
                return False
            finally:
                stop.waiting = False

        try:
            return run_calibration(
                asked, folder, daq=daq, card=card, virtual=virtual, cable=kept, operator=operator, progress=display,
                stop=stop,
            )  # fmt: skip
        except HardwareError as problem:
            if stop.pressed:
                raise KeyboardInterrupt from problem
            raise


def _virtual(
    asked: Scenario, file: Path, through: Path | None, declare: list[str] | None, snr: float, bits: int, latency: int,
    seed: int, overrides: Overrides,
) -> VirtualSetup:  # fmt: skip
    from ..questions.calibrate import VirtualSetup
    from ..questions.run import run_solve
    from ..results.files import read_transfer

    g = measured_g(through, asked, declare, "--through")
    if g is None:
        g = read_transfer(run_of(asked, file, None, run_solve, overrides).out / "transfer.nc")
    return VirtualSetup(g, snr, bits, latency, seed)


def _drives_file(what: Path) -> Path:
    """A callback: ``drives.nc`` of a folder, refused where there is none before anything is solved."""
    signals = what / "drives.nc" if what.is_dir() else what
    if not signals.is_file():
        raise DataError(f"{signals}: no such file; `forearm-fem render` makes a drives.nc")
    return signals


def play(
    scenario: ScenarioFile,
    drives: Annotated[
        Path, typer.Argument(help="drives.nc, a results folder that holds one, or a WAV file", callback=_drives_file)
    ],
    overrides: Overrides = None,
    method: Annotated[str | None, typer.Option(help="of drives.nc: inverse filter, funneling or combination")] = None,
    target: Annotated[str | None, typer.Option(help="of drives.nc: a grid point, e.g. 5")] = None,
    daq: DaqChoice = "virtual",
    through: Through = None,
    declare: Declared = None,
    full_scale: Annotated[
        float | None, typer.Option(help="of a WAV file with integer samples: volts at full scale")
    ] = None,
    scale: Annotated[float, typer.Option(help="multiplies the drives")] = 1.0,
    repeats: Annotated[int, typer.Option(min=1, help="how often the drives are sent")] = 1,
    pause: Annotated[float, typer.Option(min=0.0, help="silence between repeats, in s")] = 0.0,
    snr: Snr = 60.0,
    card: Card = None,
) -> None:
    """Send drive signals, faded and within the voltage limit; Ctrl-C fades out; press it twice to stop at once."""
    from ..questions.calibrate import run_play

    _refuse_idle(daq, card, through, declare, snr=snr)
    asked = load_scenario(scenario, overrides=overrides or ())
    virtual = _virtual(asked, scenario, through, declare, snr, 16, 0, 0, overrides) if daq == "virtual" else None
    with noted(), stop_on_ctrl_c() as stop:
        played = run_play(
            asked, drives, daq=daq, card=card, virtual=virtual, method=method, target=target, full_scale=full_scale,
            scale=scale, repeats=repeats, pause=pause, stop=stop,
        )  # fmt: skip
    typer.echo(f"played {played.seconds:.3g} s, peaks {', '.join(f'{v:.3g}' for v in played.peak)} V")
    if played.stopped:
        raise KeyboardInterrupt


def loopback(
    scenario: ScenarioFile,
    overrides: Overrides = None,
    daq: Annotated[Literal["ni", "sound"], typer.Option("--daq", help="ni: a cDAQ; sound: a sound card")] = "sound",
    card: Card = None,
    out: Annotated[
        Path, typer.Option("--out", help="record for calibrate and study run", callback=ends_in(".json"))
    ] = Path("loopback.json"),
) -> None:
    """Measure a device's latency and gain: a cable from its first output to the sensor's input."""
    from ..measurement.playback import write_loopback
    from ..questions.calibrate import run_loopback

    _refuse_idle(daq, card)
    found = run_loopback(load_scenario(scenario, overrides=overrides or ()), daq=daq, card=card)
    write_loopback(out, found)
    typer.echo(
        f"{found.device}: latency {found.latency:.2f} samples ({1e3 * found.seconds:.3f} ms, output and input "
        f"together), gain {found.gain:.4g} V/V, no copy {100 * found.residual:.2g} %\n{out}"
    )


def compare(
    what: Annotated[
        list[Path],
        typer.Argument(help="two G (files of any known kind or results folders), or two and more runs of devices",
                       callback=all_hold_g),
    ],
    out: Annotated[Path | None, typer.Option("--out", help="default results/compare-A-B")] = None,
    declare_a: Annotated[list[str] | None, declared("--declare-a", "the first")] = None,
    declare_b: Annotated[list[str] | None, declared("--declare-b", "the second")] = None,
    scenario: Annotated[
        Path | None, typer.Option(help="that was measured: points and actuators of files that name no places")
    ] = None,
    render: Annotated[bool, typer.Option(help="play the drives designed on one through the other")] = True,
) -> None:  # fmt: skip
    """Comparison of two devices (which is better, and where), or of two G of one device (where they differ, and
    why)."""
    scene, said = scene_of(scenario), (declaration(declare_a), declaration(declare_b))
    names = (p.resolve().name if p.is_dir() else p.stem for p in what)
    folder = out_folder(out, f"compare-{'-'.join(names)}")
    with job(folder, "show.devices", "questions.compare.run") as display:
        from ..questions.compare.report import console_lines
        from ..questions.compare.run import run_compare
        from ..show.devices import are_devices

        if are_devices(what):
            lines = _compared_devices(what, folder, display)
        elif len(what) == 2:
            result = run_compare(
                transfer_file(what[0]), transfer_file(what[1]), folder=folder, declaration_a=said[0],
                declaration_b=said[1], scenario=scene, render=render, progress=display,
            )  # fmt: skip
            lines = console_lines(result.comparison, folder)
        else:
            raise DataError(
                f"compare: expected two G, or runs with S; some of the {len(what)} given are no finished run: "
                "`forearm-fem render FILE` makes one of a G"
            )
    typer.echo("\n".join(lines))


def _compared_devices(what: list[Path], folder: Path, display: Display) -> list[str]:
    from ..show.devices import compare_devices, devices_console, devices_page
    from ..store.folder import set_kind

    found = compare_devices(what, display)
    set_kind(folder, "comparison of devices", {"of": [str(p) for p in what]}, ("comparison.md", "comparison.html"))
    page, _ = devices_page(found).save(folder, "comparison")
    return devices_console(found, page)


def fit(
    scenario: ScenarioFile,
    measured: Annotated[Path, typer.Argument(help="measured G: a file or a results folder", callback=holds_g)],
    parameters: Annotated[list[str], typer.Argument(help="e.g. scale delay skin.mu fat.mu coil.moving_mass")],
    overrides: Overrides = None,
    out: OutFolder = None,
    declare: Declared = None,
    frequencies: Annotated[int, typer.Option(min=2, help="of the measured bins, evenly spread")] = 24,
    fem: Annotated[
        bool,
        typer.Option("--fem/--layered", help="on the scene's own finite elements (reduced once), or its layered model"),
    ] = False,
) -> None:
    """Fit parameters of a scenario to a measured G; says what the data cannot tell and what to measure next."""
    asked = load_scenario(scenario, overrides=overrides or ())
    folder = out_folder(out, asked, overrides, "fit")
    with job(folder, "questions.compare.run") as display:
        from ..questions.compare.run import run_fit

        result = run_fit(
            asked, transfer_file(measured), parameters, folder=folder, declaration=declaration(declare),
            frequencies=frequencies, fem=fem, base=scenario.parent, named=asked_words(scenario, overrides),
            progress=display,
        )  # fmt: skip
    typer.echo(result.text)
    typer.echo(f"fit: {folder}")


# convert: any readable G, or raw sweeps, to netCDF, CSV or MATLAB.

_MOST_ALIKE = 3  # findings of one kind that are all printed
_ENDINGS = (".nc", ".csv", ".mat")


def _writable(file: Path) -> Path:
    if file.suffix.lower() not in _ENDINGS:
        raise DataError(f"{file}: cannot write '{file.suffix}'; choose a name that ends in {', '.join(_ENDINGS)}")
    refuse_folder(file)
    return file


def convert(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="IN",
            callback=holds_g,
            help="G: a file of any known kind, a results folder, or a folder or pattern of files",
        ),
    ],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="G.nc, G.csv or G.mat", callback=_writable)],
    scenario: Annotated[
        Path | None, typer.Option(help="that was measured: places, and of raw sweeps the sweep and the sensor")
    ] = None,
    overrides: Overrides = None,
    declare: Declared = None,
) -> None:
    """Write any readable G as netCDF, CSV or MATLAB; raw sweeps become G as in `calibrate`."""
    if overrides and scenario is None:
        raise DataError("--set: has no effect without --scenario; name one, or leave it out")
    apply_overrides({}, overrides or ())
    asked = None if scenario is None else load_scenario(scenario_file(scenario), overrides=overrides or ())
    from ..files.read import read
    from ..transfer import error_words

    with noted():
        g = read(transfer_file(source), declaration(declare), scenario=asked)
    g.save(target)
    usable = np.isfinite(g.values) if g.valid is None else g.valid
    typer.echo(
        f"{len(g.outputs)} points, {len(g.inputs)} actuators, {len(g.frequency)} frequencies from "
        f"{g.frequency[0]:g} to {g.frequency[-1]:g} Hz, in {g.unit}; {100 * usable.mean():.3g} % of the entries may be "
        f"used; {error_words(g.errors)}\nG: {target}"
    )
