"""`python -m mission`: the command line."""

from mission.cli import main

if __name__ == "__main__":
    main()
