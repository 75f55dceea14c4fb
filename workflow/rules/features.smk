# A frozen backbone, applied once to every frame of one task.
rule features:
    input:
        upstream("features"),
    message:
        "{rule}: {params.known_as}"
    output:
        output("features"),
    log:
        log_of("features"),
    benchmark:
        benchmark_of("features")
    params:
        request=request("features"),
        known_as=known_as("features"),
    priority: 20
    threads: 1
    shell:
        MAKE
