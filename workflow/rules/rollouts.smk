# Successful episodes of one expert, with images.
rule rollouts:
    input:
        upstream("rollouts"),
    message:
        "{rule}: {params.known_as}"
    output:
        output("rollouts"),
    log:
        log_of("rollouts"),
    benchmark:
        benchmark_of("rollouts")
    params:
        request=request("rollouts"),
        known_as=known_as("rollouts"),
    priority: 20
    threads: 1
    shell:
        MAKE
