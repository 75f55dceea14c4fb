# Single-task RL on privileged state, or a trained expert from zoo/.
rule expert:
    input:
        upstream("expert"),
    message:
        "{rule}: {params.known_as}"
    output:
        output("expert"),
    log:
        log_of("expert"),
    benchmark:
        benchmark_of("expert")
    params:
        request=request("expert"),
        known_as=known_as("expert"),
    threads: 1
    shell:
        MAKE
