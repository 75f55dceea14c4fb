# Names for people: results/<study>/<variant>/<stage> and results/<study>/<variant>/<item>/<stage>, small files that list
# directories of artifacts. `publish` writes them all; `name` makes one that is asked for by itself.
NAMES = names.all_names(PLAN)


rule name:
    input:
        lambda wildcards: manifests(NAMES[wildcards.name], unless=f"{RESULT}/{wildcards.name}"),
    output:
        RESULT + "/{name}",
    wildcard_constraints:
        name="|".join(re.escape(name) for name in NAMES),
    params:
        directories=lambda wildcards: [str(STORE.path(artifact.place)) for artifact in NAMES[wildcards.name]],
    shell:
        "printf '%s\\n' {params.directories:q} > {output}"


rule publish:
    input:
        manifests([PLAN.report], unless=PUBLISHED[0]),
    message:
        f"publish: {RESULT}/report.html and the names of the study"
    output:
        PUBLISHED,
    params:
        configuration=CONFIGURATION,
    shell:
        ACGD + " publish --fingerprint {FINGERPRINT} --configuration {params.configuration:q}"
