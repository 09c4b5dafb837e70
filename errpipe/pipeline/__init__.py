"""The engine that runs pipelines by content. It knows stages, files and hashes, and no physics.

    spec      the pipeline file, from the stages it is handed
    graph     which stage reads which
    lock      hashes of inputs and outputs, and reasons to run a stage again
    runner    plan and run: scratch folders, whole files, one lock file per OUT
    depfile   a rule for make
    schema    JSON Schemas of what people write

Why content and not time stamps: a checkout, a copy or a clock that is wrong must not decide whether a machine's
compensation is recomputed. Why not a base of ours on a workflow system: make is already there, and
`--depfile` and `--stamp` connect errpipe to it.
"""
