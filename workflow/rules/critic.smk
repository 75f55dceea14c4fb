# Q of one frozen expert, by fitted Q evaluation.
rule critic:
    input:
        upstream("critic"),
    output:
        output("critic"),
    log:
        log_of("critic"),
    benchmark:
        benchmark_of("critic")
    params:
        request=request("critic"),
    threads: 1
    shell:
        MAKE
