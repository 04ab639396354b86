"""The commands of `coldspray`, a module each: add(commands) adds the command to a parser's subcommands, run(arguments) executes it.

`run` returns the exit code. It raises ColdsprayError for an error that the user can correct.
"""
