# Names for people: results/<study>/<variant>/<stage> and results/<study>/<variant>/<item>/<stage>, small files that list
# directories of artifacts. `publish` writes them all; `name` makes one that is asked for by itself.
rule name:
    input:
        lambda wildcards: ancient([manifest(artifact) for artifact in PLAN.names[wildcards.name]]),
    output:
        RESULT + "/{name}",
    wildcard_constraints:
        name="|".join(re.escape(name) for name in PLAN.names),
    params:
        directories=lambda wildcards: [str(STORE.path(artifact.place)) for artifact in PLAN.names[wildcards.name]],
    shell:
        "printf '%s\\n' {params.directories:q} > {output}"


rule publish:
    input:
        ancient(manifest(PLAN.report)),
    output:
        PUBLISHED,
    params:
        configuration=CONFIGURATION,
    shell:
        ACGD + " publish --configuration {params.configuration:q}"
