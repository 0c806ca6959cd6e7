"""Which body and fluid parameters do recorded swims have, in the twin and in the fluid?"""
