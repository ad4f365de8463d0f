"""`robosim` in processes of their own."""

import sys


def hearing_ctrl_c(*arguments):
    """Return the command of a process that runs robosim, and hears SIGINT.

    What a shell runs in the background, and its children, ignore it.
    """
    code = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    code += f"from robosim.cli.main import main; raise SystemExit(main({list(arguments)}))"
    return [sys.executable, "-c", code]
