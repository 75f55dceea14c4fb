# Successful episodes of one expert, with images.
rule rollouts:
    input:
        upstream("rollouts"),
    output:
        output("rollouts"),
    log:
        log_of("rollouts"),
    benchmark:
        benchmark_of("rollouts")
    params:
        request=request("rollouts"),
    threads: 1
    shell:
        MAKE
