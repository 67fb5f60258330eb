"""`python -m mrbatch`: the command line."""

from mrbatch.cli import main

if __name__ == "__main__":
    main()
