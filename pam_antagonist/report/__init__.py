"""Reports: what a recording says about the estimator, as numbers, tables, figures and one self-contained page."""
