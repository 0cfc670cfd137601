# Reference values of tests/test_study_statistics.py: R's afex (car, emmeans) on three data sets.
# Rscript make_anova.R   (Debian: r-cran-afex, r-cran-emmeans)
suppressMessages({library(afex); library(emmeans)})
afex_options(correction_aov = "GG", es_aov = "ges")
set.seed(20)
frame <- function(n, scale) {
  d <- expand.grid(subject = factor(1:n), location = factor(1:9), method = factor(c("a", "b", "c")))
  own <- rnorm(n)
  noise <- rnorm(nrow(d)) * scale[d$location]
  drift <- rnorm(n)[d$subject] * (as.integer(d$location) - 5) / 4      # correlated along locations: no sphericity
  d$error <- 10 + own[d$subject] + c(0, 1, 0, 2, 1, 0, 3, 1, 0)[d$location] * 0.4 +
    c(0, 0.5, -0.3)[d$method] + ifelse(d$location == 1 & d$method == "b", 1.2, 0) + noise + drift * (max(scale) > 1)
  d
}
report <- function(name, d) {
  fit <- aov_ez("subject", "error", d, within = c("location", "method"))
  s <- suppressWarnings(summary(fit))
  cat("\n[", name, "]\n", sep = "")
  u <- s$univariate.tests[-1, ]; e <- s$pval.adjustments; m <- s$sphericity.tests
  g <- anova(fit, es = c("ges", "pes"), correction = "none")
  for (k in rownames(u)) {
    row <- c(f = u[k, "F value"], p = u[k, "Pr(>F)"], gg = e[k, "GG eps"], p_gg = e[k, "Pr(>F[GG])"],
             hf = e[k, "HF eps"], p_hf = e[k, "Pr(>F[HF])"], mauchly_w = m[k, 1], mauchly_p = m[k, 2],
             partial_eta2 = g[k, "pes"], generalised_eta2 = g[k, "ges"])
    cat(gsub(":", "_", k), " = {", paste(names(row), sprintf("%.12g", row), sep = " = ", collapse = ", "), "}\n", sep = "")
  }
  means <- aggregate(error ~ subject + method, d, mean)
  wide <- reshape(means, idvar = "subject", timevar = "method", direction = "wide")
  pairs <- combn(c("a", "b", "c"), 2)
  t <- apply(pairs, 2, function(q) { h <- t.test(wide[[paste0("error.", q[1])]], wide[[paste0("error.", q[2])]], paired = TRUE)
    c(h$statistic, h$p.value) })
  cat("pair_t = [", paste(sprintf("%.12g", t[1, ]), collapse = ", "), "]\n", sep = "")
  for (how in c("bonferroni", "holm"))
    cat("pair_", how, " = [", paste(sprintf("%.12g", p.adjust(t[2, ], how)), collapse = ", "), "]\n", sep = "")
  f <- friedman.test(as.matrix(wide[, -1]))
  cat("friedman = [", sprintf("%.12g", f$statistic), ", ", sprintf("%.12g", f$p.value), "]\n", sep = "")
}
balanced <- frame(40, rep(0.8, 9)); rough <- frame(40, c(.4, .5, .6, 2, 2.5, 3, .5, .4, 3)); few <- frame(20, rep(1, 9))
for (n in c("balanced", "rough", "few")) write.csv(get(n)[, c("subject", "location", "method", "error")], paste0(n, ".csv"), row.names = FALSE)
sink("anova.toml"); cat("# written by make_anova.R\n")
report("balanced", balanced); report("rough", rough); report("few", few)
# missing cells: subjects 3 and 7 lack one cell each; listwise analysis, and a mixed model on all cells
missing <- balanced[!(balanced$subject == 3 & balanced$location == 2 & balanced$method == "b") &
                    !(balanced$subject == 7 & balanced$location == 9 & balanced$method == "a"), ]
write.csv(missing[, c("subject", "location", "method", "error")], "missing.csv", row.names = FALSE)
report("missing", droplevels(missing[!missing$subject %in% c(3, 7), ]))
mixed <- lme4::lmer(error ~ location * method + (1 | subject), missing, REML = TRUE)
cat("mixed_method_b = ", sprintf("%.9g", lme4::fixef(mixed)["methodb"]), "\n", sep = "")
cat("mixed_sigma = ", sprintf("%.9g", sigma(mixed)), "\n", sep = "")
cat("mixed_subject_sd = ", sprintf("%.9g", attr(lme4::VarCorr(mixed)$subject, "stddev")), "\n", sep = "")
sink()
