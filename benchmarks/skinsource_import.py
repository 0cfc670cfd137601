"""A real measured G (SkinSource) through the recipe in docs/howto/recipes.md: condition, S of all renderers.

python benchmarks/skinsource_import.py [FOLDER] [--figure FILE.png] [--write]

``--write`` puts the table into docs/howto/recipes.md. The data are not part of the project.
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from forearm_fem.files.recipe import ImportRecipe, import_by_recipe
from forearm_fem.metrics import condition_number
from forearm_fem.questions.compare.compare import wavelet_for
from forearm_fem.rendering import (
    Combination,
    Funneling,
    InverseFilter,
    Regularisation,
    Renderer,
    SearchedZeros,
    render_all,
)
from forearm_fem.show.calibration import plot_entries
from forearm_fem.transfer import TransferMatrix

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs" / "howto" / "recipes.md"
SHARED = ROOT.parent / "shared" / "data" / "skinsource"


def recipe_from_docs() -> ImportRecipe:
    """The recipe as the documentation prints it."""
    text = DOCS.read_text(encoding="utf-8")
    found = re.search(r"```toml\n# recipe: skinsource\n(.*?)```", text, re.DOTALL)
    assert found is not None
    return ImportRecipe.model_validate(tomllib.loads(found[1]))


def renderers() -> tuple[Renderer, ...]:
    """The thesis' three; the two inverse ones damped by Tikhonov at 5 %; and those with searched zero
    points.
    """
    damped = Regularisation("tikhonov", 0.05)
    return (
        InverseFilter(),
        Funneling(),
        Combination(),
        InverseFilter(regularisation=damped, name="inverse filter, Tikhonov 0.05"),
        Combination(regularisation=damped, name="combination, Tikhonov 0.05"),
        InverseFilter(SearchedZeros(), damped, name="inverse filter, Tikhonov 0.05, searched zeros"),
        Combination(SearchedZeros(), damped, name="combination, Tikhonov 0.05, searched zeros"),
    )


def report(g: TransferMatrix) -> str:
    """Condition numbers and S per renderer, in markdown."""
    condition, control = condition_number(g.values), condition_number(g.values[:, [4, 0, 2, 6, 8]])
    wavelet = wavelet_for(g.frequency)
    table = render_all(g, methods=renderers(), wavelet=wavelet).table()
    lines = [
        "| G | |",
        "|---|---|",
        f"| frequencies | {len(g.frequency)}, {g.frequency[0]:.1f} to {g.frequency[-1]:.1f} Hz |",
        f"| outputs, inputs | {g.values.shape[1]}, {g.values.shape[2]} |",
        f"| condition number | {condition.min():.1f} to {condition.max():.1f}, median {np.median(condition):.1f} |",
        f"| the same of the five control points for target 5 | {control.min():.1f} to {control.max():.0f}, median "
        f"{np.median(control):.0f} |",
        "",
        "| S | " + " | ".join(table.groups) + " |",
        "|---|" + "---|" * len(table.groups),
    ]
    for m, name in enumerate(table.methods):
        cells = [
            f"{mean:.2f}" if np.isnan(std) else f"{mean:.2f} ± {std:.2f}"
            for mean, std in zip(table.mean[:, m], table.std[:, m], strict=True)
        ]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def figure(g: TransferMatrix, file: Path) -> None:
    """|G| of all entries and the condition number."""
    picture = Figure(figsize=(10, 4), layout="constrained")
    left, right = picture.subplots(1, 2)
    plot_entries(g, ax=left)
    right.semilogy(g.frequency, condition_number(g.values))
    right.set(xlabel="frequency [Hz]", ylabel="condition number [-]")
    picture.savefig(file, dpi=120)


def write_docs(text: str) -> None:
    """The table between its marks in the documentation."""
    begin, end = "<!-- skinsource: begin -->", "<!-- skinsource: end -->"
    before, _, rest = DOCS.read_text(encoding="utf-8").partition(begin)
    DOCS.write_text(f"{before}{begin}\n{text}\n{end}{rest.partition(end)[2]}", encoding="utf-8")


def main(arguments: list[str]) -> None:
    """Import, report, and draw if asked."""
    plain = [a for a in arguments if not a.startswith("--") and not a.endswith(".png")]
    folder = Path(plain[0]) if plain else SHARED
    g = import_by_recipe(recipe_from_docs(), folder)
    text = report(g)
    print(text)
    for file in (a for a in arguments if a.endswith(".png")):
        figure(g, Path(file))
    if "--write" in arguments:
        write_docs(text)


if __name__ == "__main__":
    main(sys.argv[1:])
