"""The commands, called in this process as a shell would call them."""

from typer.testing import CliRunner

RUNNER = CliRunner()


def called(app, *arguments):
    """Exit status, standard output and standard error; any other exception is the test's."""
    result = RUNNER.invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr
