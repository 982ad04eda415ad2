# Builds the examples as build/<preset>/examples/<name>.
foreach(name hello telemetry teleoperation camera transfer request rescue state log dig wombat)
  add_executable(example_${name} ${repository}/examples/${name}/main.cpp)
  target_link_libraries(example_${name} PRIVATE rect::rect Threads::Threads)
  set_target_properties(example_${name} PROPERTIES OUTPUT_NAME ${name} RUNTIME_OUTPUT_DIRECTORY ${CMAKE_CURRENT_BINARY_DIR}/examples)
endforeach()

foreach(name hello rescue state log dig)
  add_executable(example_${name}_c ${repository}/examples/${name}/main.c)
  target_link_libraries(example_${name}_c PRIVATE rect::rect)
  set_target_properties(example_${name}_c PROPERTIES
                        OUTPUT_NAME ${name}_c RUNTIME_OUTPUT_DIRECTORY ${CMAKE_CURRENT_BINARY_DIR}/examples)
endforeach()
