"""Measurement files in laboratory and shop formats, converted into a recording folder from confirmed guesses.

A reader (one file in `readers/`) reads one kind of file and returns its cells; `layout` finds header, units and data;
`columns` guesses the role of each column; `proposal` and `resolve` turn the guesses into rows and a manifest. A
pipeline uses nothing of this package: it reads the recording folder, whose manifest the user has confirmed.
"""
