# What a policy that sees little, or all, does from the same starts.
rule controls:
    input:
        upstream("controls"),
    message:
        "{rule}: {params.known_as}"
    output:
        output("controls"),
    log:
        log_of("controls"),
    benchmark:
        benchmark_of("controls")
    params:
        request=request("controls"),
        known_as=known_as("controls"),
    priority: -10
    threads: 1
    shell:
        MAKE
