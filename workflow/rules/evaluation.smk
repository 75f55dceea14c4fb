# A student on held-out seeds.
rule evaluation:
    input:
        upstream("evaluation"),
    message:
        "{rule}: {params.known_as}"
    output:
        output("evaluation"),
    log:
        log_of("evaluation"),
    benchmark:
        benchmark_of("evaluation")
    params:
        request=request("evaluation"),
        known_as=known_as("evaluation"),
    threads: 1
    shell:
        MAKE
