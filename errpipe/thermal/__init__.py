"""Common parts of the thermal families: rises and lags, causes of heat, thermal network, competition, intervals."""
