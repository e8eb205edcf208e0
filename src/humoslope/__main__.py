"""`python -m humoslope`, which is also how torchrun starts several processes: `torchrun -m humoslope train ...`."""

import sys

from humoslope.cli import main

if __name__ == "__main__":
    sys.exit(main())
