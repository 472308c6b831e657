"""`python -m sitl.conformance`: see `sitl.conformance.cli`."""

import typer

from sitl.conformance.cli import conformance

if __name__ == "__main__":
    typer.run(conformance)
