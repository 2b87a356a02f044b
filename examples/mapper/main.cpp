#include "program.hpp"

int main(int argc, char** argv) { return chainslam::mapper::run_program(argc, argv); }
