"""`python -m errpipe`: the command line where the script `errpipe` is not on the path."""

import sys

from errpipe.cli.app import main

sys.exit(main())
