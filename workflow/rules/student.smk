# Stage (b): one student of all tasks, with or without the critics.
rule student:
    input:
        upstream("student"),
    message:
        "{rule}: {params.known_as}"
    output:
        output("student"),
    log:
        log_of("student"),
    benchmark:
        benchmark_of("student")
    params:
        request=request("student"),
        known_as=known_as("student"),
    threads: 1
    shell:
        MAKE
