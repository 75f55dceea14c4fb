# One process mirrors the whole study: importing mlflow costs seconds. It never fails.
rule mlflow:
    input:
        manifests(PLAN.artifacts.values(), unless=MIRRORED),
    message:
        "mlflow: mirrors the study"
    output:
        MIRRORED,
    log:
        f"results/logs/mlflow-{STUDY.name}.log",
    params:
        configuration=CONFIGURATION,
    shell:
        ACGD + " mlflow-sync --fingerprint {FINGERPRINT} --configuration {params.configuration:q} 2>&1 | tee {log}"
