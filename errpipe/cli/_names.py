"""The verbs, in the order in which the help lists them."""

VERBS = (
    *("check", "import", "init", "plan", "run", "demo"),
    *("predict", "eval", "show", "whatis", "diagnose", "export", "verify", "targets", "compare", "compare-targets"),
    *("correct", "measure", "place", "plan-day", "synthesis", "retrain", "fleet"),
    *("keygen", "sign", "verify-signature", "promote", "rollback", "log"),
    *("terms", "formats", "explain", "doctor", "completion", "schema", "reference"),
)
