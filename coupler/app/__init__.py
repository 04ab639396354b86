"""The command line as a page in a browser of this machine: forms, runs while they are computed, results.

A run is a process of `coldspray` itself, which outlives the server; all that a page knows of it is in its folder.
"""
