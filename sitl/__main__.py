"""`python -m sitl`: see `sitl.cli`."""

import typer

from sitl.cli import sitl

if __name__ == "__main__":
    typer.run(sitl)
