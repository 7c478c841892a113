"""The data sheets *Linear* and *General* of EMVA Standard 1288, release 4.0 (2021), with intervals
for every figure."""
