# Single-task RL on privileged state, or a trained expert from zoo/.
rule expert:
    input:
        upstream("expert"),
    output:
        output("expert"),
    log:
        log_of("expert"),
    benchmark:
        benchmark_of("expert")
    params:
        request=request("expert"),
    threads: 1
    shell:
        MAKE
