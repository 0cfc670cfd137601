"""Do the degrees of freedom and probabilities of a published analysis fit its design? Here: of de Vlam 2022, V.C."""

from __future__ import annotations

from dataclasses import dataclass

from scipy import stats


@dataclass(frozen=True)
class Claim:
    """A reported test of a within-subject effect: F(df, df_error) = f, p, in a design of ``levels`` of its factors."""

    name: str
    contrasts: int
    df: int
    df_error: int
    f: float
    p: float


PUBLISHED = (
    Claim("error, location", 8, 6, 360, 15.888, 0.000),
    Claim("error, method", 2, 2, 115, 4.487, 0.014),
    Claim("error, location x method", 16, 12, 726, 3.825, 0.000),
    Claim("points, method", 2, 2, 115, 6.152, 0.003),
    Claim("points, location", 8, 7, 418, 3.692, 0.001),
    Claim("points, location x method", 16, 11, 681, 0.719, 0.728),
)
PARTICIPANTS, REPETITIONS = 20, 3


@dataclass(frozen=True)
class Verdict:
    """Rows that explain a claim's degrees of freedom, and the probability that follows from its F.

    ``subjects`` is None where no number of rows explains them with an ``epsilon`` of at most 1; ``sentence`` says what
    does not add up, or that all does.
    """

    claim: Claim
    subjects: int | None
    epsilon: float
    p: float
    sentence: str


def judge(claim: Claim, participants: int = PARTICIPANTS, repetitions: int = REPETITIONS) -> Verdict:
    """Explain the degrees of freedom by participants, or by participants times repetitions, and recompute p.

    df_error = epsilon d (n - 1) is known to its integer part; df = epsilon d must be within 1 of what is reported, as
    the thesis rounds some and cuts others.
    """
    for subjects in (participants, participants * repetitions):
        epsilon = claim.df_error / (claim.contrasts * (subjects - 1))
        if epsilon <= 1 + 1e-9 and abs(epsilon * claim.contrasts - claim.df) < 1:
            df = epsilon * claim.contrasts
            p = float(stats.f.sf(claim.f, df, claim.df_error))
            return Verdict(claim, subjects, epsilon, p, _sentence(claim, subjects, participants, epsilon, p))
    p = float(stats.f.sf(claim.f, claim.df, claim.df_error))
    return Verdict(claim, None, float("nan"), p, f"{claim.name}: no number of rows explains the degrees of freedom.")


def _sentence(claim: Claim, subjects: int, participants: int, epsilon: float, p: float) -> str:
    """One line on where the degrees of freedom come from, and one on the probability where it differs."""
    said = f"F({claim.df}, {claim.df_error}) fits {subjects} rows with epsilon {epsilon:.2f}"
    if subjects != participants:
        right = epsilon * claim.contrasts * (participants - 1)
        said += (
            f": repetitions were counted as subjects. {participants} participants give {right:.0f} error degrees of "
            "freedom at the same epsilon"
        )
    if round(epsilon * claim.contrasts) != claim.df:
        said += f"; {epsilon * claim.contrasts:.2f} was reported as {claim.df}"
    off = "" if abs(p - claim.p) < 6e-4 else f"; p from F would be {p:.4f}, not {claim.p:.3f}"
    return f"{claim.name}: {said}{off}."


def verdicts() -> tuple[Verdict, ...]:
    """The verdict on each of the thesis' tests."""
    return tuple(judge(c) for c in PUBLISHED)
