"""The applications: each makes constraints from what is asked, and calls the fit."""
