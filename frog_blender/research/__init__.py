"""Many trainings: the chart, the stability suite, the papers' protocols. Not in the extension."""
