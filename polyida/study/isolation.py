"""A run in a process of its own: a crash or a hang of it is an outcome, not the end of the study."""

import multiprocessing
import traceback


def run_isolated(function, arguments, limit):
    """`function(**arguments)` in a new process, at most `limit` seconds.

    Returns its dictionary with "error" empty, or {"error": what happened}: an exception by its text, "crash" with the signal or
    exit code where the process died, "hang" where it did not end.
    """
    context = multiprocessing.get_context("spawn")
    receive, send = context.Pipe(duplex=False)
    process = context.Process(target=_call, args=(send, function, arguments), daemon=True)
    process.start()
    send.close()
    try:
        row = receive.recv() if receive.poll(limit) else {"error": f"hang: no end within {limit:g} s", "outcome": "hang"}
    except EOFError:
        process.join(5)
        row = {"error": f"crash: exit code {process.exitcode}", "outcome": "crash"}
    finally:
        if process.is_alive():
            process.kill()
        process.join()
    return row


def _call(send, function, arguments):
    try:
        row = {"error": ""} | function(**arguments)
    except Exception as error:
        row = {"error": f"{type(error).__name__}: {error}", "traceback": traceback.format_exc(limit=-4)}
    send.send(row)
