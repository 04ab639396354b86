"""The local web page of coldspray: forms for the input, the state of runs while they are computed, and their results.

Each run is a separate process of the command `coldspray`, which continues when the server ends. The page reads all data about a run
from the folder of the run.
"""
