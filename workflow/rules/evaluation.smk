# A student on held-out seeds.
rule evaluation:
    input:
        upstream("evaluation"),
    output:
        output("evaluation"),
    log:
        log_of("evaluation"),
    benchmark:
        benchmark_of("evaluation")
    params:
        request=request("evaluation"),
    threads: 1
    shell:
        MAKE
