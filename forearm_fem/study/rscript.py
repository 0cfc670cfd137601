"""The same tests in R, beside our own tables: afex, emmeans, and a mixed model of all trials by lme4."""

from __future__ import annotations

from .plan import Analysis

_SCRIPT = """# {what}: the tests of report.html again in R. Run it in this folder: Rscript {name}.R
# Plan {digest}: {sphericity}, {correction} within each family, alpha {alpha}.
# With no more participants than contrasts R corrects no degrees of freedom, and says so; report.html does.
suppressMessages({{library(afex); library(emmeans)}})
factors <- c("participant", "location", "method")
cells <- read.csv("{name}-cells.csv", colClasses = c(participant = "character", location = "character"))
cells[factors] <- lapply(cells[factors], factor)
fit <- aov_ez("participant", "value", cells, within = c("location", "method"))
table <- as.data.frame(nice(fit, correction = "{short}", es = c("pes", "ges"), intercept = FALSE))
print(table)
exact <- as.data.frame(anova(fit, correction = "{short}", es = c("pes", "ges")))
exact$effect <- rownames(exact)
write.csv(exact, "{name}-r-anova.csv", row.names = FALSE)

# pairs of methods over all targets, and at each target: each a family; intervals hold the whole family at once
paired <- function(means) {{
  found <- as.data.frame(contrast(means, "pairwise", by = NULL, adjust = "none"))
  if ("location" %in% names(means@grid)) {{
    found <- as.data.frame(pairs(means, adjust = "none"))
  }}
  reach <- qt(1 - {alpha} / 2 / nrow(found), found$df) * found$SE
  found$low <- found$estimate - reach
  found$high <- found$estimate + reach
  found$p.corrected <- p.adjust(found$p.value, "{correction}")
  if (!"location" %in% names(found)) found$location <- ""
  found[c("location", "contrast", "estimate", "low", "high", "t.ratio", "df", "p.corrected")]
}}
both <- rbind(paired(emmeans(fit, ~method, model = "multivariate")),
              paired(emmeans(fit, ~ method | location, model = "multivariate")))
print(both)
write.csv(both, "{name}-r-pairs.csv", row.names = FALSE)
{mixed}"""
_MIXED = """
# every trial, participants without all cells too; each person has an own effect of method and of target
if (requireNamespace("lmerTest", quietly = TRUE)) {{
  trials <- read.csv("{trials}.csv", colClasses = c(participant = "character", target = "character"))
  trials$location <- factor(trials$target)
  model <- lmerTest::lmer({measure} ~ location * method + (1 | participant) + (1 | participant:method) +
                          (1 | participant:location), trials)
  print(anova(model))
}}
"""


def script(name: str, trials: str, measure: str, plan: Analysis) -> str:
    """An R script that reads the cells of ``name`` and the table ``trials``, and writes its own results beside them.

    Precision is no measure of single trials, so that it has no mixed model.
    """
    mixed = "" if measure == "precision" else _MIXED.format(trials=trials, measure=measure)
    return _SCRIPT.format(
        what=name.replace("-", ", "), name=name, digest=plan.digest, sphericity=plan.sphericity,
        correction=plan.correction, alpha=f"{plan.alpha:g}",
        short="GG" if plan.sphericity == "Greenhouse-Geisser" else "HF", mixed=mixed,
    )  # fmt: skip
