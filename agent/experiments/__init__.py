"""The paper's experiments: what each of its figures takes, computed; `mission.reproduce` draws them."""
