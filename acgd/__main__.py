"""The command line: `python -m acgd <verb>`. A verb imports only the modules that it uses."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from acgd import chain
from acgd.store.store import ArtifactError, Store
from acgd.study.load import ConfigError


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one verb. Returns the exit status: 1 after an error that the user can mend."""
    options = _parser().parse_args(arguments)
    try:
        return options.run(options) or 0
    except (ConfigError, ArtifactError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:
        return 0
    except KeyboardInterrupt:
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m acgd",
        description="ACGD: experts, critics, demonstrations, students. Snakemake runs the stages.",
    )
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="verb")

    for stage in chain.names():
        verb = verbs.add_parser(stage, help=f"make one artifact of the stage {stage} (the workflow calls this)")
        verb.add_argument(
            "request",
            type=Path,
            metavar="request.json",
            help="the request of the artifact: results/work/<stage>/<name>/<key>/request.json",
        )
        verb.add_argument("--threads", type=int, default=1)
        verb.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto")
        verb.set_defaults(run=_make, stage=stage)

    verb = verbs.add_parser("check", help="validate studies, and list the artifacts that each still needs")
    _studies(verb, "check")
    verb = verbs.add_parser("ls", help="list the artifacts in the store")
    _studies(verb, "list_store")
    verb = verbs.add_parser("gc", help="remove artifacts that no study names")
    verb.add_argument("--yes", action="store_true", help="remove them; without --yes, gc only lists them")
    _studies(verb, "free", "yes")
    verb = verbs.add_parser("verify", help="compare every file with its checksum")
    verb.add_argument(
        "--repair", action="store_true", help="remove damaged artifacts, so that the workflow makes them again"
    )
    verb.set_defaults(run=_verify)
    verb = verbs.add_parser("mlflow-sync", help="write the artifacts to MLflow")
    verb.add_argument("--configuration", help="a whole configuration as JSON, instead of files (used by the workflow)")
    verb.add_argument("--fingerprint", help="with --configuration: fingerprint that is recorded as mirrored")
    verb.add_argument(
        "studies", nargs="*", type=Path, metavar="study.yaml", help="default: config.yaml and studies/*.yaml"
    )
    verb.set_defaults(run=_mirror)
    verb = verbs.add_parser(
        "publish", help="write report and names of a study to results/<study>/ (the workflow calls this)"
    )
    verb.add_argument("--configuration", required=True, help="the study's whole configuration as JSON")
    verb.add_argument("--fingerprint", required=True, help="fingerprint of the plan that the workflow has run")
    verb.add_argument("--source", default="", help="path of the study's configuration, which is recorded")
    verb.set_defaults(run=_publish)
    verb = verbs.add_parser("keep", help="keep a study's finished results, without weights, under docs/results/")
    verb.add_argument("study", type=Path, metavar="study.yaml")
    verb.add_argument("--folder", type=Path, help="default: docs/results/<study>/kept")
    verb.set_defaults(run=_keep)
    verb = verbs.add_parser(
        "restore", help="copy kept results into the store, so that the workflow can build the report"
    )
    verb.add_argument("study", type=Path, metavar="study.yaml", nargs="?")
    verb.add_argument("--folder", type=Path, help="default: docs/results/<study>/kept")
    verb.add_argument("--discard", action="store_true", help="instead, remove all restored artifacts from the store")
    verb.set_defaults(run=_restore)
    verb = verbs.add_parser("schema", help="write docs/configuration.md and docs/schema.json")
    verb.add_argument("--docs", type=Path, default=Path("docs"))
    verb.set_defaults(run=_schema)
    for verb in verbs.choices.values():
        verb.add_argument(
            "--store",
            type=Path,
            default=Path("results"),
            metavar="results",
            help="folder of the results (default: results)",
        )

    from acgd.experts import zoo_commands

    zoo_commands.add_parser(verbs)
    from acgd.export import commands as export_commands

    export_commands.add_parser(verbs)
    return parser


def _studies(verb: argparse.ArgumentParser, command: str, *extra: str) -> None:
    """Adds the argument `studies`, and calls a function of acgd/study/commands.py with it and the `extra` options."""
    verb.add_argument(
        "studies", nargs="*", type=Path, metavar="study.yaml", help="default: config.yaml and studies/*.yaml"
    )

    def run(options: argparse.Namespace) -> None:
        from acgd.study import commands

        getattr(commands, command)(Store(options.store), options.studies, *(getattr(options, name) for name in extra))

    verb.set_defaults(run=run)


def _make(options: argparse.Namespace) -> None:
    from acgd.store.job import make, read_request
    from acgd.study.plan import identity

    job = read_request(options.request)
    if job["stage"] != options.stage:
        command = f"python -m acgd {job['stage']} {options.request}"
        raise ArtifactError(f"{options.request} is a request of the stage {job['stage']}. Type: {command}")
    make(job, chain.stage(options.stage), identity, Store(options.store), options.threads, options.device)


def _verify(options: argparse.Namespace) -> None:
    from acgd.study.commands import verify

    verify(Store(options.store), options.repair)


def _mirror(options: argparse.Namespace) -> None:
    from acgd.study import commands, names

    store = Store(options.store)
    if options.configuration is None:
        commands.mirror(store, commands.plans(options.studies))
        return
    plan = _planned(options.configuration)
    commands.mirror(store, [plan])
    names.mark(store, "mirrored", plan.study, options.fingerprint)


def _publish(options: argparse.Namespace) -> None:
    from acgd.study import names

    plan = _planned(options.configuration)
    if names.fingerprint(plan) != options.fingerprint:
        raise ArtifactError(
            "Code, simulator or a file that the study reads has changed since the workflow was started. "
            "Start the workflow again."
        )
    print(f"report: {names.publish(Store(options.store), plan, options.source)}")


def _keep(options: argparse.Namespace) -> None:
    from acgd.study import kept
    from acgd.study.commands import plans

    (plan,) = plans([options.study])
    folder = options.folder or kept.folder_of(plan.study)
    outcome = kept.keep(Store(options.store), plan, folder)
    print(f"kept {len(outcome.done)} artifacts in {folder}; {len(outcome.missing)} are not finished")
    for file in outcome.too_large:
        print(f"left out, since it is too large: {file}")


def _restore(options: argparse.Namespace) -> None:
    from acgd.study import kept
    from acgd.study.commands import plans

    store = Store(options.store)
    if options.discard:
        print(f"removed {len(kept.discard(store))} restored artifacts")
        return
    if options.study is None:
        raise ArtifactError("No study is named. Name the study to restore, or type --discard.")
    (plan,) = plans([options.study])
    outcome = kept.restore(store, plan, options.folder or kept.folder_of(plan.study))
    counts = f"{len(outcome.present)} were in the store already, {len(outcome.missing)} were not kept"
    print(f"restored {len(outcome.done)} artifacts; {counts}")
    if outcome.missing:
        print("Not kept, or settings, code or a task have changed since:", *outcome.missing[:5], sep="\n  ")
    else:
        print(f"Build the report: snakemake --cores 2 results/{plan.study}/report.html --configfile {options.study}")


def _planned(configuration: str):
    from acgd.study.plan import plan
    from acgd.study.study import load_study

    return plan(load_study(json.loads(configuration)))


def _schema(options: argparse.Namespace) -> None:
    from acgd.study.reference import write

    write(options.docs)


def run() -> None:
    """The installed command `acgd`."""
    sys.exit(main())


if __name__ == "__main__":
    run()
