"""The history of what ran on which machine: signed, append-only, content-addressed, in plain folders.

minisign   keys and signatures in the file format of the program `minisign` (Ed25519)
store      promote, roll back, log: which table was on which machine when, and why
"""
