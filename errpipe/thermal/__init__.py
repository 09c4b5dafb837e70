"""What the thermal families share: rises and lags, causes of heat, the thermal network, competition, intervals."""
