"""Measurement files as labs and shops have them, turned into a recording folder of confirmed guesses.

A door (one file in `doors/`) opens one kind of file and gives its cells; `layout` finds header, units and data;
`columns` guesses what each column is; `proposal` and `resolve` turn the guesses into rows and a manifest. Nothing here
is used by a pipeline: a pipeline reads the recording folder, whose manifest a person has confirmed.
"""
