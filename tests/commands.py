"""Call the commands in this process as a shell would."""

from typer.testing import CliRunner

RUNNER = CliRunner()


def called(app, *arguments):
    """Return exit status, standard output and standard error. Other exceptions are raised."""
    result = RUNNER.invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr
