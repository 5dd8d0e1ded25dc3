"""The exit codes of the command line."""

DONE = 0
FIT_FAILED = 1
WRONG_CALL = 2
TOO_MANY_FAILED = 3
STOPPED = 4
INTERRUPTED = 130
