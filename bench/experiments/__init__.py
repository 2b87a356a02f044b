"""The tables of the paper, made by one command: see README.md and run.sh."""
