"""Table 1 of the paper: test losses as printed, mean and standard deviation over five runs."""

# (system, method) -> the printed text. The cart-pole's SINDy entry sums over all four states,
# the other two methods' over the first two.
TABLE_1: dict[tuple[str, str], str] = {
    ("lotka-volterra", "dynaifeynman"): "0.19 ± 0.05",
    ("pendulum", "dynaifeynman"): "2.41 ± 0.13",
    ("cart-pole", "dynaifeynman"): "1.23 ± 0.36",
    ("lotka-volterra", "ga"): "2.13 ± 1.11",
    ("pendulum", "ga"): "2.47 ± 0.003",
    ("cart-pole", "ga"): "0.771 ± 0.79",
    ("lotka-volterra", "sindy"): "0.24",
    ("pendulum", "sindy"): "2.19",
    ("cart-pole", "sindy"): "1.92",
}
