"""`acgd zoo`: lists, verifies and evaluates the trained experts in zoo/."""

import argparse
import json
import sys


def add_parser(subparsers) -> None:
    """Adds `zoo list | verify | manifest | evaluate | card` to the command line."""
    zoo = subparsers.add_parser("zoo", help="list, verify and re-evaluate the trained experts in zoo/")
    verbs = zoo.add_subparsers(dest="verb", required=True)
    verbs.add_parser("list", help="a line for each expert").set_defaults(run=_list)
    verbs.add_parser("verify", help="check the manifest and cards against files, tasks and versions").set_defaults(
        run=_verify
    )
    verbs.add_parser("manifest", help="write manifest.json and the pages of the experts").set_defaults(run=_manifest)
    evaluate = verbs.add_parser("evaluate", help="measure an expert's success again")
    evaluate.add_argument("task", help="name or slug, such as myo/key-turn")
    evaluate.add_argument("--episodes", type=int, default=200)
    evaluate.add_argument("--seed", type=int, default=0, help="offset into the seeds for expert cards")
    evaluate.add_argument("--start", choices=("perturbed", "nominal"), default="perturbed")
    evaluate.add_argument("--json", action="store_true")
    evaluate.set_defaults(run=_evaluate)
    rewrite = verbs.add_parser("card", help="measure an expert and rewrite its card")
    rewrite.add_argument("task")
    rewrite.add_argument("--episodes", type=int, default=200)
    rewrite.set_defaults(run=_card)


def _entries():
    from acgd.experts import zoo
    from acgd.tasks.spec import TASKS

    return [(spec, folder) for spec in TASKS.values() if (folder := zoo.folder(spec.name)).is_dir()]


def _find(name: str):
    import difflib

    entries = {spec.slug: (spec, folder) for spec, folder in _entries()}
    slug = name.replace("/", "-")
    if slug not in entries:
        nearest = difflib.get_close_matches(slug, entries, n=1, cutoff=0.0)
        sys.exit(
            f"the zoo has no {name!r}; nearest is {nearest[0] if nearest else 'none'}. It has: {', '.join(entries)}"
        )
    return entries[slug]


def _list(args: argparse.Namespace) -> int:
    for spec, folder in _entries():
        card = json.loads((folder / "card.json").read_text())
        final = card["success"]["final"]
        print(f"{spec.name:22} {card['algorithm']:24} {card['steps']:>9} steps  "
              f"final {final['rate']:.2f} [{final['low']:.2f}, {final['high']:.2f}] of {card['episodes']}")  # fmt: skip
    return 0


def _verify(args: argparse.Namespace) -> int:
    from acgd.experts.card import check, other_versions
    from acgd.experts.zoo_manifest import faults

    faulty = 0
    for spec, folder in _entries():
        try:
            card = check(folder)
        except (ValueError, FileNotFoundError) as error:
            print(f"{spec.name}: {error}")
            faulty += 1
            continue
        if manifest_faults := list(faults(spec, folder)):
            print(*(f"{spec.name}: {fault}" for fault in manifest_faults), sep="\n")
            faulty += 1
            continue
        notes = other_versions(card)
        print(f"{spec.name}: sound" + (f"; warning: {'; '.join(notes)}: re-evaluate it" if notes else ""))
    return 1 if faulty else 0


def _manifest(args: argparse.Namespace) -> int:
    from acgd.experts import zoo_manifest

    zoo_manifest.write(_entries())
    return 0


def _evaluate(args: argparse.Namespace) -> int:
    from acgd.experts.card import other_versions, read, success
    from acgd.experts.policy import Expert
    from acgd.experts.success import episodes
    from acgd.simulate.seeds import SEEDS
    from acgd.tasks.settings import TaskConfig

    spec, folder = _find(args.task)
    for note in other_versions(read(folder)):
        print(f"warning: {note}", file=sys.stderr)
    count = 1 if args.start == "nominal" else args.episodes
    rows = episodes(
        Expert.load(folder), TaskConfig(name=spec.name, start=args.start), SEEDS.expert_card.take(count, args.seed)
    )
    result = {"task": spec.name, "start": args.start, "episodes": count, "first_seed": rows[0]["seed"],
              "success": success(rows)}  # fmt: skip
    if args.json:
        print(json.dumps(result))
    else:
        for rule, value in result["success"].items():
            print(f"{spec.name} {rule:6} {value['rate']:.3f} [{value['low']:.3f}, {value['high']:.3f}] of {count}")
    return 0


def _card(args: argparse.Namespace) -> int:
    from acgd.experts.card import describe, measurements, write
    from acgd.experts.settings import ExpertRequest

    _, folder = _find(args.task)
    request = ExpertRequest.model_validate_json((folder / "request.json").read_text())
    card = describe(request.expert, request.task, folder) | measurements(folder, request.task, args.episodes)
    write(card, folder)
    return _list(args)
