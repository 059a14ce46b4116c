"""The command line: `pretouch serve | up | healthcheck`, and the commands that other packages offer.

Services and commands are found by entry points (`pretouch.services`, `pretouch.commands`) and imported only when they
are called, so that `pretouch --help` is quick and needs no extra.
"""

from __future__ import annotations

import asyncio
import os
import sys
from contextlib import suppress
from importlib.metadata import entry_points, version
from io import TextIOWrapper
from pathlib import Path
from shutil import get_terminal_size
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.markup import escape
from typer.core import TyperGroup

from pretouch.commands import COMMANDS, add_commands, explain_called, explain_missing, read_called_words
from pretouch.config_file import read_config
from pretouch.errors import Conflict, InvalidInput, NotFound, PretouchError, Unauthenticated, Unavailable
from pretouch.interrupts import INTERRUPTED, Terminated, raising_interrupts

_PORTS = {"orchestrator": 50050, "detector": 50051, "registrar": 50052, "gateway": 50053}
_SERVE_HELP = {
    "orchestrator": """The sessions, their store, and the REST API: what a robot talks to.

    Its own options are environment variables:

    - PRETOUCH_ORCHESTRATOR_DETECTOR, PRETOUCH_ORCHESTRATOR_REGISTRAR: host:port of those services

    - PRETOUCH_ORCHESTRATOR_GATEWAY: host:port; left out, robots send their samples themselves

    - PRETOUCH_ORCHESTRATOR_STATE: directory of the session store

    - PRETOUCH_ORCHESTRATOR_REST_HOST (127.0.0.1), PRETOUCH_ORCHESTRATOR_REST_PORT (8080)

    - PRETOUCH_ORCHESTRATOR_ALLOWED_HOSTS: more names by which REST may be called, separated by commas
    """,
    "detector": "Where is it worth looking? Proposes regions of a depth image to scan.",
    "registrar": """Where is the object? Estimates the correction from the scans, and predicts what a scan would bring.

    Its own option is an environment variable:

    - PRETOUCH_REGISTRAR_ENGINE: the engine for requests that name none
    """,
    "gateway": """What did the finger measure? Owns the serial ports.

    Its own option is an environment variable:

    - PRETOUCH_GATEWAY_DEVICES: name=port,name=port, or the path of a .toml file that says more
    """,
}

_EPILOG = (
    "Exit codes: 0 done, 1 failed, 2 wrong usage (an option, or a file that it names), 130 interrupted. "
    "What runs until it is told to stop (up, serve, gateway watch) ends with 0 when it is."
)
_LEAST_WIDTH = 80
"""Columns of a terminal in which the help is drawn in boxes; narrower ones would cut it."""
_USAGE = (Conflict, InvalidInput, NotFound, Unauthenticated)
"""Errors of what the user gave: exit code 2."""

Host = Annotated[str, typer.Option(envvar="PRETOUCH_HOST", help="Address to listen on.")]
Token = Annotated[
    str | None,
    typer.Option(envvar="PRETOUCH_TOKEN", help="Bearer token that every call must carry.", show_default=False),
]
TokensFile = Annotated[
    Path | None,
    typer.Option(
        envvar="PRETOUCH_TOKENS_FILE",
        help="TOML file of more tokens, each with an owner and a role (pretouch token new).",
        show_default=False,
    ),
]
OpenMetrics = Annotated[bool, typer.Option(envvar="PRETOUCH_OPEN_METRICS", help="Metrics need no token.")]
LogLevel = Annotated[str, typer.Option(envvar="PRETOUCH_LOG_LEVEL", help="debug, info, warning or error.")]
ServerCert = Annotated[
    Path | None, typer.Option(envvar="PRETOUCH_TLS_CERT", help="Certificate to serve TLS with.", show_default="no TLS")
]
ServerKey = Annotated[Path | None, typer.Option(envvar="PRETOUCH_TLS_KEY", help="Its key.")]
ClientCa = Annotated[
    Path | None,
    typer.Option(envvar="PRETOUCH_TLS_CLIENT_CA", help="Authority whose certificate every client must show."),
]
TlsCa = Annotated[Path | None, typer.Option(help="The authority that signed the service's certificate.")]
TlsCert = Annotated[Path | None, typer.Option(help="A client's certificate, where the service asks for one.")]
TlsKey = Annotated[Path | None, typer.Option(help="Its key.")]


def _serve(
    context: typer.Context,
    host: Host = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option(envvar="PRETOUCH_PORT", help="gRPC port; 0 for a free one.", show_default="the service's own"),
    ] = None,
    metrics_port: Annotated[
        int | None,
        typer.Option(envvar="PRETOUCH_METRICS_PORT", help="Port of the Prometheus page.", show_default="off"),
    ] = None,
    token: Token = None,
    tokens_file: TokensFile = None,
    open_metrics: OpenMetrics = False,
    tls_cert: ServerCert = None,
    tls_key: ServerKey = None,
    tls_client_ca: ClientCa = None,
    workers: Annotated[int, typer.Option(envvar="PRETOUCH_WORKERS", help="Threads for CPU work.")] = 2,
    max_queue: Annotated[
        int, typer.Option(envvar="PRETOUCH_MAX_QUEUE", help="CPU jobs that may wait; more are refused.")
    ] = 16,
    memory: Annotated[
        str | None,
        typer.Option(
            envvar="PRETOUCH_MEMORY",
            help="Memory that the process may use, such as 800M or 2G.",
            show_default="half of the machine's or the container's",
        ),
    ] = None,
    grace: Annotated[
        float, typer.Option(envvar="PRETOUCH_GRACE", help="Seconds that running calls get at shutdown.")
    ] = 5.0,
    log_level: LogLevel = "info",
    watched: Annotated[
        bool, typer.Option("--watched", help="Serve in a child process that is restarted when it hangs or ends.")
    ] = False,
    alive_file: Annotated[
        Path | None,
        typer.Option(
            envvar="PRETOUCH_ALIVE_FILE", help="With --watched: a file that is touched while the service serves."
        ),
    ] = None,
    until_stdin_closes: Annotated[bool, typer.Option(hidden=True)] = False,
    health_socket: Annotated[Path | None, typer.Option(hidden=True)] = None,
) -> None:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # numpy reads it: they would be beside our own
    from pretouch.serving import Settings, serve
    from pretouch.serving.memory import choose_default_memory
    from pretouch.serving.quantities import parse_bytes

    name = str(context.info_name)
    settings = Settings(
        host=host,
        port=_PORTS[name] if port is None else port,
        metrics_port=metrics_port,
        token=token,
        tokens_file=tokens_file,
        open_metrics=open_metrics,
        tls_cert=tls_cert,
        tls_key=tls_key,
        tls_client_ca=tls_client_ca,
        workers=workers,
        max_queue=max_queue,
        memory=parse_bytes(memory, "PRETOUCH_MEMORY") if memory else choose_default_memory(),
        grace=grace,
        log_level=log_level,
        health_socket=health_socket,
    )
    if watched:
        from pretouch.serving.watched import serve_watched

        asyncio.run(serve_watched(name, settings, os.environ | _as_environment(context), alive_file))
        return
    (service,) = entry_points(group="pretouch.services", name=name)
    try:
        asyncio.run(serve(name, service.load(), settings, until_stdin_closes=until_stdin_closes))
    except ModuleNotFoundError as error:
        raise explain_missing(error, f"The {name}", name) from error


def _as_environment(context: typer.Context) -> dict[str, str]:
    """The command's options as the environment variables that say the same; a token is then in no list of processes."""
    values = {
        str(option.envvar): context.params[str(option.name)] for option in context.command.params if option.envvar
    }
    return {name: str(value) for name, value in values.items() if value is not None}


def _up(
    config: Annotated[
        Path | None,
        typer.Option(
            help="A TOML file of these options, such as rest-port = 8080; what the command line says comes first.",
            callback=read_config,
            is_eager=True,
        ),
    ] = None,
    host: Annotated[
        str, typer.Option(envvar="PRETOUCH_HOST", help="Where REST and gRPC of the orchestrator are served.")
    ] = "127.0.0.1",
    rest_port: Annotated[int, typer.Option(help="Port of REST; 0 for a free one.")] = 8080,
    grpc_port: Annotated[int, typer.Option(help="Port of gRPC; 0 for a free one.")] = _PORTS["orchestrator"],
    gateway_port: Annotated[
        int, typer.Option(help="Port of the sensor gateway's gRPC on 127.0.0.1; 0 for a free one.")
    ] = _PORTS["gateway"],
    state: Annotated[
        Path | None, typer.Option(help="Directory of the sessions.", show_default="~/.local/state/pretouch")
    ] = None,
    device: Annotated[
        list[str] | None, typer.Option(help="A finger's serial port as NAME=PORT; may be repeated.")
    ] = None,
    foxglove: Annotated[
        bool, typer.Option("--foxglove", help="Show the newest session on a WebSocket that Foxglove connects to.")
    ] = False,
    foxglove_port: Annotated[
        int, typer.Option(min=0, max=65535, help="Its port on 127.0.0.1; 0 for a free one.")
    ] = 8765,
    rerun: Annotated[
        bool, typer.Option("--rerun", help="Show the newest session in Rerun, on 127.0.0.1:9090 for browsers.")
    ] = False,
    token: Token = None,
    tokens_file: TokensFile = None,
    open_metrics: OpenMetrics = False,
    tls_cert: ServerCert = None,
    tls_key: ServerKey = None,
    tls_client_ca: ClientCa = None,
    log_level: LogLevel = "warning",
    until_stdin_closes: Annotated[bool, typer.Option(hidden=True)] = False,
) -> None:
    """Run all four services of one machine until Ctrl-C or SIGTERM."""
    from pretouch.serving.live_view import LiveView
    from pretouch.serving.settings import Settings
    from pretouch.serving.up import Stack, up

    home = Path(os.environ.get("XDG_STATE_HOME") or "~/.local/state").expanduser() / "pretouch"
    settings = Settings(
        host=host,
        port=grpc_port,
        token=token,
        tokens_file=tokens_file,
        open_metrics=open_metrics,
        tls_cert=tls_cert,
        tls_key=tls_key,
        tls_client_ca=tls_client_ca,
        log_level=log_level,
    )
    shown = LiveView(foxglove_port if foxglove else None, rerun)
    stack = Stack(settings, rest_port, gateway_port, state or home, tuple(device or ()), view=shown)
    if sys.stderr.isatty():
        print("Starting the services; the first start on a machine compiles for a minute or two.", file=sys.stderr)
    asyncio.run(up(stack, lambda line: print(line, flush=True), until_stdin_closes=until_stdin_closes))


def _healthcheck(
    address: Annotated[
        str | None, typer.Argument(help="host:port", show_default="127.0.0.1 and PRETOUCH_PORT or 50050")
    ] = None,
    timeout: Annotated[float, typer.Option(help="Seconds to wait for the answer.")] = 3.0,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
) -> None:
    """Ask a service whether it serves; exit code 0 if it does, else 1."""
    import grpc
    from grpc_health.v1 import health_pb2, health_pb2_grpc

    from pretouch.channel import open_sync_channel
    from pretouch.errors import from_rpc_error

    target = address or f"127.0.0.1:{os.environ.get('PRETOUCH_PORT') or _PORTS['orchestrator']}"
    with open_sync_channel(target, None, tls_ca, tls_cert, tls_key) as channel:
        try:
            answer = health_pb2_grpc.HealthStub(channel).Check(health_pb2.HealthCheckRequest(), timeout=timeout)
        except grpc.RpcError as error:
            explained = from_rpc_error(error)
            raise Unavailable(f"{target}: {explained.detail}", explained.remedy) from error
    status = health_pb2.HealthCheckResponse.ServingStatus.Name(answer.status)
    print(f"{target}: {status}")
    raise typer.Exit(0 if answer.status == health_pb2.HealthCheckResponse.SERVING else 1)


def _new_token(
    owner: Annotated[str, typer.Argument(help="Whose sessions calls with this token make and see.")],
    read_only: Annotated[bool, typer.Option("--read-only", help="Calls with it may change nothing.")] = False,
) -> None:
    """Make a token: prints it on standard error, and its entry for PRETOUCH_TOKENS_FILE on standard output."""
    from pretouch.serving.tokens import make_token

    token, entry = make_token(owner, "read" if read_only else "full")
    print(f"Keep this token, nothing else holds it: {token}", file=sys.stderr)
    print(entry, end="")


class _Commands(TyperGroup):
    """The commands; an interrupt ends each with one line."""

    def invoke(self, ctx: Any) -> Any:
        with raising_interrupts():
            try:
                return super().invoke(ctx)
            except KeyboardInterrupt as interrupt:
                if not isinstance(interrupt, Terminated):
                    print("Interrupted.", file=sys.stderr)
                raise typer.Exit(INTERRUPTED) from None


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"pretouch {version('pretouch')}")
        raise typer.Exit


def _options(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Options of the command line itself."""


def _app(called: str | None) -> typer.Typer:
    """The whole command line; of the other packages' commands only the `called` one is imported."""
    app = typer.Typer(
        name="pretouch",
        help="A better object pose for any robot, from a time-of-flight sensor in its fingertip.",
        no_args_is_help=True,
        epilog=_EPILOG,
        cls=_Commands,
        rich_markup_mode="rich" if get_terminal_size().columns >= _LEAST_WIDTH else None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_options)
    app.command("up")(_up)
    serve = typer.Typer(help="Run one service.", no_args_is_help=True)
    for name, text in _SERVE_HELP.items():
        serve.command(name, help=text)(_serve)
    app.add_typer(serve, name="serve")
    app.command("healthcheck")(_healthcheck)
    token = typer.Typer(help="Make tokens.", no_args_is_help=True)
    token.callback()(lambda: None)
    token.command("new")(_new_token)
    app.add_typer(token, name="token")
    add_commands(app, COMMANDS, called)
    return app


def main() -> None:
    """Runs the command line; an error is printed in two lines, with exit code 2 if what the user gave caused it."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # closed streams are None
            with suppress(OSError):  # a stream for reading and writing on a terminal cannot be reconfigured
                stream.reconfigure(errors="replace")  # a terminal of ASCII still gets the numbers
    try:
        _app(read_called_words()[0])(prog_name="pretouch")
    except PretouchError as error:
        _refuse(error)
    except OSError as error:  # a disk that is full, standard output that is closed
        if error.filename is None:
            with suppress(OSError):
                sys.stdout.flush()
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # or Python complains again when it ends
        what = f"{error.filename} cannot be used" if error.filename else "The output cannot be written"
        _refuse(Unavailable(f"{what}: {error.strerror or error}."))
    except ModuleNotFoundError as error:  # at import or only once the command runs
        for explained in explain_called(error):
            _refuse(explained)
        raise


def _refuse(error: PretouchError) -> NoReturn:
    console = Console(stderr=True, soft_wrap=True, highlight=False)
    console.print(f"[bold red]{escape(error.detail)}[/]")
    if error.remedy:
        console.print(escape(error.remedy))
    sys.exit(2 if isinstance(error, _USAGE) else 1)
