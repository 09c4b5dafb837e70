"""What a command does that is no stage of a pipeline: one module a verb, glue only. Heavy imports wait inside."""
