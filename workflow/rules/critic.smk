# Q of one frozen expert, by fitted Q evaluation.
rule critic:
    input:
        upstream("critic"),
    message:
        "{rule}: {params.known_as}"
    output:
        output("critic"),
    log:
        log_of("critic"),
    benchmark:
        benchmark_of("critic")
    params:
        request=request("critic"),
        known_as=known_as("critic"),
    priority: 10
    threads: 1
    shell:
        MAKE
